"""Which motion distinguishes rivals: what to record next, so that a cause gets one name."""
