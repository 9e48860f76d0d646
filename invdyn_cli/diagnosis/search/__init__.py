"""Which few causes explain the evidence together: search on Gram matrices and exact refinement in turn."""
