"""What the models that are networks share."""

from typing import Any

import jax
import numpy as np

from invdyn_cli.types import Dataset, Fit, PyTree


def trained(
    dataset: Dataset,
    scales: PyTree,
    nets: PyTree,
    history: dict[str, np.ndarray],
    details: dict[str, Any] | None = None,
) -> Fit:
    """The fit of nets in the standardisation `scales`, with a warning if their training diverged."""
    leaves = jax.tree.leaves(nets)
    finite = all(np.isfinite(leaf).all() for leaf in leaves)
    diverged = "Training diverged: some weights are not finite. A smaller learning rate helps."
    return Fit(
        params={**scales, "nets": nets},
        robot=dataset.robot,
        joints=dataset.joints,
        parameters=sum(leaf.size for leaf in leaves),
        history=history,
        details=details or {},
        warnings=() if finite else (diverged,),
    )
