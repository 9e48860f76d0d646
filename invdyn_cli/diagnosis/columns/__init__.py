"""From a log to evidence: rows on one clock, and the columns of every effect beside the logged torque."""
