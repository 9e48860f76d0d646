"""A diagnosis on the terminal: the verdict, the causes, the errors; rich objects that fit 100 columns."""

import math

from rich import box
from rich.table import Table
from rich.text import Text

from invdyn_cli.diagnosis.decide.wording import in_table, units_of
from invdyn_cli.report.quantities import best_gain, gain_text
from invdyn_cli.report.tables import significant
from invdyn_cli.report.wording import (
    EACH_LOG,
    UNSEEN,
    capital,
    cause,
    causes,
    each_log,
    estimates,
    gaining,
    included,
    joints_of,
    perhaps,
    place,
    places,
    standard_rows,
    verdict_words,
    when,
    words,
)
from invdyn_cli.types import Diagnosis

VERDICT_STYLE = {"explained": "bold green", "partly_explained": "bold yellow", "log_unusable": "bold red"}
OPEN = {"ambiguous": "\nambiguous"}


def verdict_line(diagnosis: Diagnosis) -> Text:
    """The verdict in a word, then the summary."""
    return Text.assemble(
        (verdict_words(diagnosis), VERDICT_STYLE.get(diagnosis.verdict, "bold")), f". {diagnosis.summary}".rstrip()
    )


def finding_table(diagnosis: Diagnosis) -> Table:
    """A row per claim that is no term of `standard_table`, 'X or Y' where the log leaves it open, with its window if it
    comes and goes; below the table what the log could not have shown."""
    caption = Text(unseen_line(diagnosis), style="dim")
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, caption=caption if caption else None, caption_justify="left")
    unit = "; ".join(dict.fromkeys(units_of(diagnosis).values())) or "N m"
    table.add_column("cause", overflow="fold", max_width=30)
    table.add_column("joint", overflow="fold", max_width=18)
    table.add_column("estimate [95 %]", overflow="fold")
    table.add_column(f"RMSE falls by [{unit}]", overflow="fold")
    for _, finding in causes(diagnosis):
        joint = best_gain(finding.gain)
        gain = "-" if joint is None else gain_text(finding.gain[joint])
        where = f"\n{said}" if joint is not None and (said := gaining(joint, finding)) else ""
        table.add_row(
            Text(capital(cause(finding))),
            Text.assemble(place(finding), (OPEN.get(finding.status, ""), "yellow")),
            Text("\n".join(x for x in (*estimates(finding), when(finding)) if x) or "-"),
            Text(gain + where),
        )
    if not table.row_count:
        table.add_row("none beyond the standard terms" if in_table(diagnosis) else "none")
    return table


def standard_table(diagnosis: Diagnosis) -> Table | None:
    """What every arm has, as the extended model has it: a row a joint, bold where the log proves it by itself; None
    where the model has none of it."""
    rows, heads = standard_rows(diagnosis)
    if not heads:
        return None
    said = (
        f"Standard terms of every arm; bold: also claimed as a cause{perhaps(diagnosis)}.{included(diagnosis)} "
        f"Links: {_links(diagnosis)}."
    )
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, caption=Text(said, style="dim"), caption_justify="left")
    table.add_column("joint", overflow="fold", max_width=24)
    units = {name: dict.fromkeys(terms[name]["unit"] for terms in rows.values() if name in terms) for name in heads}
    for name in heads:
        only = next(iter(units[name])) if len(units[name]) == 1 else ""
        table.add_column(Text(f"{name}\n[{only}]" if only else name), justify="right")
    for joint, terms in rows.items():
        told = []
        for name in heads:
            x = terms.get(name)
            unit = f" {x['unit']}" if x and len(units[name]) > 1 else ""
            open_one = "perhaps" in x if x else False
            style = "bold" if x and (x["claimed"] or open_one) else ""
            told.append(Text(significant(x["value"]) + "*" * open_one + unit, style) if x else Text("-"))
        table.add_row(Text(joint), *told)
    return table


def _links(diagnosis: Diagnosis) -> str:
    """How far the links' inertials are off, and on which joint that makes most."""
    share, worth = (diagnosis.standard["inertials"][x] for x in ("share", "worth"))
    most = max(worth, key=lambda joint: worth[joint])
    made = f"makes up to {significant(worth[most])} {units_of(diagnosis)[most]} ({most})"
    return f"typically {100 * share:.3g} % off in the URDF, which {made}" if share else "as the URDF has them"


def each_log_table(diagnosis: Diagnosis) -> Table | Text | None:
    """Offsets and frictions that differ between the logs of a comparison; a line if none does; None without a
    reference."""
    rows = each_log(diagnosis)
    if not rows:
        return None
    differing = [cells for differs, cells in rows if differs]
    if not differing:
        return Text("Each log was fitted separately: no offset and no friction differs from the reference.", "dim")
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, caption_justify="left")
    table.caption = Text("Offset and friction that differ, fitted to each log by itself; ± 95 %.", "dim")
    for head in EACH_LOG:
        table.add_column(head, overflow="fold", justify="left" if head in EACH_LOG[:2] else "right")
    for cells in differing:
        table.add_row(*map(Text, cells))
    return table


def unclaimed_line(diagnosis: Diagnosis) -> Text | None:
    """'Also in the extended model, without being claimed: base tilt; …'; None where there is nothing."""
    said = [words(x.effect) + (f" on {x.joint}" if x.joint else "") for x in diagnosis.unclaimed]
    head = "Also in the extended model without being claimed, because this predicts held-out data better"
    return Text(f"{head}: {'; '.join(said)}.", "dim") if said else None


def unseen_line(diagnosis: Diagnosis) -> str:
    """'This log cannot show: Stribeck friction (joint3, joint4), …', nothing where nothing was hidden."""
    hidden: dict[str, dict[str, None]] = {}
    for x in diagnosis.findings:
        if x.status in UNSEEN:
            hidden.setdefault(x.effect, {})[place(x)] = None  # once, with one encoder or with another
    said = [f"{words(effect)} ({places(found, joints_of(diagnosis))})" for effect, found in hidden.items()]
    return f"This log cannot show: {'; '.join(said)}." if said else ""


ERROR_HEADS = (
    "RMSE nominal",
    "friction line",
    "standard model",
    "extended model",
    "noise floor",
    "NMSE extended",
    "unexplained",
)


def error_table(diagnosis: Diagnosis) -> Table:
    """Held-out errors per joint of the nominal model, the extended model and the usual baselines, beside the noise
    floor and what a learner still predicts."""
    units = units_of(diagnosis)
    others: dict[str, list[str]] = {}
    for joint, unit in units.items():
        others.setdefault(unit, []).append(joint)
    usual = next(iter(others)) if len(others) == 1 else "N m"
    said = usual + "".join(f" ({u} for {', '.join(joints)})" for u, joints in others.items() if u != usual)
    table = Table(
        box=box.SIMPLE_HEAD, pad_edge=False, caption=Text(f"Held-out data, also at rest; RMSE in {said}.", style="dim")
    )
    table.add_column("joint", overflow="fold", max_width=24)
    for head in (*ERROR_HEADS[:-2], ERROR_HEADS[-1]):  # 80 characters hold all but the NMSE
        table.add_column(Text(head.replace(" ", "\n")), justify="right", no_wrap=True)
    for joint in joints_of(diagnosis):
        share = diagnosis.unexplained.get(joint)
        left = "-" if share is None or math.isnan(share) else f"{100 * share:.0f} %"
        table.add_row(Text(joint), *map(significant, errors_of(diagnosis, joint)[:-1]), left)
    return table


def errors_of(diagnosis: Diagnosis, joint: str) -> tuple[float | None, ...]:
    """The numbers of a joint under ERROR_HEADS, without the last."""
    lines = (diagnosis.baselines.get(name, {}) for name in ("friction", "standard"))
    rmse = (table.get(joint, {}).get("rmse") for table in (diagnosis.baseline, *lines, diagnosis.extended))
    floor = (diagnosis.noise_floor or {}).get(joint, {}).get("rmse")
    return (*rmse, floor, diagnosis.extended.get(joint, {}).get("nmse"))
