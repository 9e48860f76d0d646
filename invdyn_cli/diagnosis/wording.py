"""The verdict, in one word and in two sentences."""

from collections.abc import Mapping, Sequence

import numpy as np

from invdyn_cli.diagnosis.findings import Made
from invdyn_cli.types import Diagnosis

PREDICTABLE, SMALL = 0.15, 0.15
"""What is left counts as explained where the learner predicts less than this share of the residual's variance, or less
than this share of the nominal model's error, in N m."""


def verdict(
    made: Made,
    learned: np.ndarray,
    restless: np.ndarray,
    floor: np.ndarray | None,
    extended: Mapping[str, Mapping[str, float]],
) -> str:
    """explained, partly_explained or nothing_found."""
    if not any(f.status in ("named", "ambiguous") for f in made.findings):
        return "nothing_found"
    before = np.sqrt(np.mean(made.before**2, axis=0))
    after = np.array([x["rmse"] for x in extended.values()])
    left = np.where(restless, 1.0, np.sqrt(np.nan_to_num(learned))) * after
    fine = ~(restless | (learned > PREDICTABLE)) | (left < SMALL * before)
    if floor is not None:
        fine |= after < 1.2 * np.sqrt(2) * floor
    return "explained" if np.all(fine) else "partly_explained"


def summary(diagnosis: Diagnosis, titles: Mapping[str, str]) -> str:
    """The verdict in two or three sentences.

    Args:
        titles: of the effects, by name.
    """
    still = [j for j, share in diagnosis.unexplained.items() if np.isnan(share)]
    said = _summary(diagnosis, titles)
    return f"{said} Not judged, as hardly moving in this log: {', '.join(still)}." if still else said


def _summary(diagnosis: Diagnosis, titles: Mapping[str, str]) -> str:
    claims = [f for f in diagnosis.findings if f.status in ("named", "ambiguous")]
    before, after = (
        np.sqrt(np.mean([x["rmse"] ** 2 for x in table.values()])) for table in (diagnosis.baseline, diagnosis.extended)
    )
    rest = _rest(diagnosis)
    if not claims:
        first = f"No cause was found: the nominal model leaves {before:.3g} N m RMS over all joints."
        return f"{first} {rest or 'What is left looks like noise.'}"
    said = [
        f"{titles[f.effect]}{' or its rivals' if f.status == 'ambiguous' else ''}"
        + (f" on {f.joint}" if f.joint else "")
        for f in claims[:4]
    ]
    more = f" and {len(claims) - 4} more" if len(claims) > 4 else ""
    first = f"The simulation lacks {_listed(said)}{more}; with that its held-out error falls from {before:.3g} to "
    first += f"{after:.3g} N m RMS over all joints."
    if diagnosis.verdict == "explained" and rest:
        return f"{first} What is left is small beside that."
    return f"{first} {rest or 'What is left looks like noise.'}"


def _rest(diagnosis: Diagnosis) -> str:
    """What is left and is no noise, "" if there is none."""
    shares = {j: share for j, share in diagnosis.unexplained.items() if share > PREDICTABLE}
    swings = [j for j in diagnosis.details.get("beyond_noise", ()) if j not in shares]
    said = []
    if shares:
        most = f"a learner still predicts up to {100 * max(shares.values()):.0f} % of the residual"
        said.append(f"Something unknown remains on {', '.join(shares)}: {most}.")
    if swings:
        said.append(f"What is left on {', '.join(swings)} is no noise, though no learner predicts it from the motion.")
    return " ".join(said)


def _listed(words: Sequence[str]) -> str:
    return words[0] if len(words) == 1 else ", ".join(words[:-1]) + " and " + words[-1]
