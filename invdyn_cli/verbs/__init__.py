"""The command line: a module for each verb, and what they share."""

import logging

logging.getLogger("matplotlib").setLevel(logging.ERROR)  # a cache that it cannot write costs it some time, no more
