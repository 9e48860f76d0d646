"""Pure functions: rigid bodies, regression, signals, metrics, statistics; in 64 bit (`precision`)."""

from invdyn_cli import precision as precision
