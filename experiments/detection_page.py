"""Detection limits as a table and a figure."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from matplotlib.figure import Figure

from invdyn_cli.report import canvas
from invdyn_cli.report.wording import capital, words

if TYPE_CHECKING:
    from experiments.detection import Limit

COLOURS = (canvas.VERMILLION, canvas.BLUE, canvas.GREEN, canvas.ORANGE, canvas.PURPLE, canvas.SKY)
MARKS = "os^DvP"
ASIDE = 1.025
"""Points of the next effect stand so much to the right: sizes on one ladder would hide each other."""


def table(limits: Sequence["Limit"]) -> str:
    """A row per effect, a column per noise: size as a share of the joint's torque, and in its unit."""
    noises = sorted({x.noise for x in limits})
    at = {(x.effect, x.noise): x for x in limits}
    lines = ["| found in 9 of 10 logs from | " + " | ".join(f"noise {100 * x:g} %" for x in noises) + " |"]
    lines.append("|---|" + "---|" * len(noises))
    for effect in dict.fromkeys(x.effect for x in limits):
        cells = [_cell(at.get((effect, noise))) for noise in noises]
        lines.append(f"| {capital(words(effect))} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def _cell(limit: "Limit | None") -> str:
    if limit is None:
        return "-"
    if limit.share is None or limit.size is None:
        return "not found"
    thousand, hundred, plain = (f"{k * limit.size:.2g}" for k in (1000, 100, 1))
    size = {"s": f"{thousand} ms", "-": f"{hundred} % of the gain"}.get(limit.unit, f"{plain} {limit.unit}")
    return f"{100 * limit.share:.2g} % ({size})"


def figure(limits: Sequence["Limit"]) -> Figure:
    """Smallest size over noise, both as shares of the joint's torque, a line per effect."""
    with canvas.house_style():
        return _figure(limits)


def _figure(limits: Sequence["Limit"]) -> Figure:
    drawn = Figure(figsize=(7.5, 4.6), layout="constrained")
    axes = drawn.subplots()
    noises = [100 * x for x in sorted({x.noise for x in limits})]
    for k, effect in enumerate(dict.fromkeys(x.effect for x in limits)):
        aside = ASIDE ** (k - 2.5)
        own = [(100 * x.noise * aside, 100 * x.share) for x in limits if x.effect == effect and x.share is not None]
        x, y = zip(*sorted(own), strict=True) if own else ((), ())
        colour, mark = COLOURS[k % len(COLOURS)], MARKS[k % len(MARKS)]
        axes.plot(x, y, color=colour, marker=mark, lw=1.6, ms=6, mec="white", mew=0.5, label=words(effect))
    axes.plot(noises, noises, color=canvas.GREY, lw=1, ls="--", label="as large as the noise", zorder=1)
    axes.set_title("Found in 9 of 10 logs from this size on (arms of 4 joints, 20 s at 1 kHz)")
    axes.set_xscale("log")
    axes.set_xticks(noises, [f"{x:g}" for x in noises])
    axes.set_xticks([], minor=True)
    canvas.log_axis(axes)
    axes.set_xlabel("torque noise, RMS [% of the joint's RMS torque]")
    axes.set_ylabel("torque that the effect makes, RMS [% of the same]")
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
    return drawn
