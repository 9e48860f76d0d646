"""The picture that opens a diagnosis: measured torque beside that of the nominal and of the extended model."""

import numpy as np
from matplotlib.figure import Figure

from invdyn_cli.diagnosis.decide.wording import units_of
from invdyn_cli.report.canvas import MEASURED, WIDTH, add_legend, label_below, limit_around, plain, shape_of, thinned
from invdyn_cli.report.exhibits import as_numpy, telling_window
from invdyn_cli.report.overview import AFTER, BEFORE
from invdyn_cli.report.tables import significant
from invdyn_cli.report.wording import joints_of
from invdyn_cli.types import Diagnosis

OVERLAY = "torques"
"""What the picture's file is called."""


def overlay(diagnosis: Diagnosis) -> Figure:
    """Every joint's torques in the held-out seconds in which the nominal model is most at fault."""
    assert diagnosis.signals is not None
    joints, units, signals = joints_of(diagnosis), units_of(diagnosis), as_numpy(diagnosis.signals)
    n, fault = len(joints), signals.tau - signals.nominal
    rows = telling_window(signals, fault / np.maximum(np.nanstd(signals.tau, axis=0), 1e-300), range(n))
    height, columns = shape_of(n)
    figure = Figure(figsize=(WIDTH, 1.35 * height + 1.0), layout="constrained")
    figure.suptitle("Measured and modelled torque", x=0.01, ha="left", fontsize=11, fontweight="bold")
    grid = figure.subplots(height, columns, squeeze=False, sharex=True)
    t = signals.t[rows]
    for i, axes in enumerate(grid.flat[:n]):
        measured, nominal, extended = (x[rows, i] for x in (signals.tau, signals.nominal, signals.extended))
        axes.plot(*thinned(t, nominal), color=BEFORE, lw=1.6, label="nominal model")
        axes.plot(*thinned(t, measured), color=MEASURED, lw=1.6, label="measured")
        axes.plot(*thinned(t, extended), color=AFTER, lw=1.2, ls=(0, (4, 1.5)), label="extended model")
        limit_around(axes, measured, np.concatenate([nominal, extended]))
        before, after = (
            significant(x.get(joints[i], {}).get("rmse")) for x in (diagnosis.baseline, diagnosis.extended)
        )
        axes.set_title(plain(f"{joints[i]}    held-out RMSE {before} → {after} {units[joints[i]]}"))
        axes.set_ylabel(f"torque [{units[joints[i]]}]")
        axes.margins(x=0.01)
        label_below(axes, f"time in {plain(str(signals.trajectory[rows.start]))} [s]", i, n)
    for axes in grid.flat[n:]:
        axes.remove()
    add_legend(figure, grid.flat[0])
    return figure
