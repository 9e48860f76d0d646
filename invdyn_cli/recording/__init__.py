"""One path from a log to rows: selection, usable rows, order and units of columns, resampling, filters, derivatives.

`rows` and `channels` are used everywhere; `conditioning` makes trajectories for learning, `pieces` the data of a
diagnosis, `stretches` the data of the checks.
"""
