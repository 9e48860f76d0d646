"""Files in other formats as invdyn logs: a reader for each format, and the column map that says what their columns
mean."""
