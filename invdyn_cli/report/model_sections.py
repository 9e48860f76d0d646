"""The sections of a diagnosis page on what the extended model has beside the causes."""

from collections.abc import Mapping
from html import escape
from typing import Any

from invdyn_cli.diagnosis.decide.wording import units_of
from invdyn_cli.report.html import folded, row, table
from invdyn_cli.report.quantities import quantity_text
from invdyn_cli.report.tables import significant
from invdyn_cli.report.wording import (
    EACH_LOG,
    capital,
    claims,
    each_log,
    estimates,
    included,
    place,
    standard_rows,
    words,
)
from invdyn_cli.types import Diagnosis, Quantity


def standard_section(diagnosis: Diagnosis) -> str:
    """The terms of every joint in the written model, named or not."""
    rows, heads = standard_rows(diagnosis)
    if not heads:
        return ""
    links, body = diagnosis.standard["inertials"], ""
    numbers = {(x.effect, x.joint): k + 1 for k, x in enumerate(claims(diagnosis))}
    for joint, terms in rows.items():
        cells = [_term(x, numbers.get((x.get("effect"), joint))) if x else "-" for x in map(terms.get, heads)]
        cells.append(f"{significant(links['worth'][joint])} {units_of(diagnosis).get(joint, 'N m')}")
        body += row(escape(joint), *cells)
    how = {"left out": "estimated by leaving motions out", "evidence": "estimated from one motion by its evidence"}
    about = f"typically off in the URDF by {100 * links['share']:.3g} % ({how.get(links['chosen'], links['chosen'])})."
    if not links["share"]:
        about = "left as the URDF has them, because held-out data are predicted better so."
    note = (
        "Every arm has these terms in addition to its URDF. All are part of the extended model; bold ones are "
        "significant by themselves. Links: RMS of the torque by which the corrected inertial parameters of the links "
        "change the model. These parameters are " + about
    )
    if diagnosis.details.get("torque_side") == "link":
        note += " The torque was measured on the link side of the gear, so this friction is that of bearings, seals, "
        note += "cables and, if the sensor measures it, a part of the gear."
    note += included(diagnosis)
    made = table(("joint", *heads, "links"), body, "dense") + f'<p class="note">{escape(note)}</p>'
    return made + _each_log(diagnosis)


def _each_log(diagnosis: Diagnosis) -> str:
    """Offset and friction of the logs of a comparison; nothing without a reference."""
    rows, body = each_log(diagnosis), ""
    for differs, cells in rows:
        body += row(*(f"<b>{escape(x)}</b>" if differs else escape(x) for x in cells))
    note = "Each log was fitted separately, beside the other changes. ± 95 %. Bold: the sizes differ significantly."
    many = sum(differs for differs, _ in rows)
    label = f"Offset and friction in the reference and now: {many} of {len(rows)} differ"
    return folded(label, table(EACH_LOG, body, "dense") + f'<p class="note">{note}</p>', shown=many > 0) if rows else ""


def _term(term: Mapping[str, Any], number: int | None) -> str:
    """A term's value; of one that is claimed a link to its evidence."""
    quantity = Quantity(term["value"], term["unit"], term["interval95"])
    value = quantity_text(quantity, interval=False)
    ends = f"<small>{escape(quantity_text(quantity).removeprefix(value).strip())}</small>"
    value = escape(value)
    if not number or not (term["claimed"] or "perhaps" in term):
        return value + ends
    others = f"<small>or {escape(' or '.join(map(words, term['perhaps'])))}</small>" if "perhaps" in term else ""
    return f'<a href="#finding-{number}"><b>{value}</b></a>{ends}{others}'


def unclaimed_section(diagnosis: Diagnosis) -> str:
    """The effects in the written model that are not claimed."""
    body = ""
    for x in diagnosis.unclaimed:
        values = "<br>".join(map(escape, estimates(x)))
        less = " or ".join(map(words, x.evidence.get("in_place_of", ())))
        name = escape(capital(words(x.effect))) + (f"<small>in place of {escape(less)}</small>" if less else "")
        body += f'<tr><td class="whole">{name}</td><td>{escape(place(x))}</td><td>{values}</td></tr>'
    note = (
        "No claims are made: each of these torques may stand for another effect. They are in the extended model, "
        "because it predicts held-out data better with them. Standard terms, causes and residual tests on this page "
        "were computed without them."
    )
    return table(("effect", "joint", "estimate [95 %]"), body, "words") + f'<p class="note">{note}</p>' if body else ""
