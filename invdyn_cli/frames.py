"""A log as a table of pandas, where pandas is installed."""

from typing import TYPE_CHECKING

import numpy as np

from invdyn_cli.errors import LogError, UsageError

if TYPE_CHECKING:
    from pandas import DataFrame

    from invdyn_cli.logfile import Log


def frame(log: "Log", channels: tuple[str, ...]) -> "DataFrame":
    """The rows of all trajectories under trajectory and t [s] as index; a column for every joint of every channel that
    the log has, called q_JOINT, tau_JOINT, …, NaN where a trajectory lacks it; and the stage.

    Raises:
        UsageError: if pandas is not installed.
        LogError: for a channel that has not a row for every time and a column for every joint.
    """
    try:
        import pandas as pd
    except ImportError as error:
        raise UsageError("to_pandas needs the library pandas", advice='pip install "invdyn[pandas]"') from error
    parts = []
    for one in log.trajectories:
        columns = {"trajectory": np.full(len(one.t), one.name), "t": one.t}
        for channel in channels:
            if (values := getattr(one, channel)) is not None:
                if np.shape(values) != (shape := (len(one.t), len(log.joints))):
                    got = f"trajectory {one.name!r}: {channel} has shape {np.shape(values)}"
                    raise LogError(f"{got}; allowed in a table: {shape}")
                columns |= {f"{channel}_{joint}": x for joint, x in zip(log.joints, values.T, strict=True)}
        if one.stage is not None:
            columns["stage"] = one.stage
        parts.append(pd.DataFrame(columns))
    return pd.concat(parts).set_index(["trajectory", "t"])
