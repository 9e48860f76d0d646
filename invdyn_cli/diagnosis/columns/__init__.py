"""From a log to evidence: rows on one clock, and the torque columns of every effect."""
