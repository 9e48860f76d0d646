"""One path from a log to rows: selection, usable rows, order and units of columns, resampling, filters, derivatives.

`rows` and `channels` hold what every use shares; `conditioning` makes trajectories to learn from, `pieces` what a
diagnosis looks at, `stretches` what the checks of a log look at.
"""
