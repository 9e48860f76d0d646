"""Which motion tells rivals apart: what to record next, so that a cause gets one name."""
