"""Which few causes explain the evidence together: alternating search on Gram matrices and exact refinement."""
