"""Text between two markers of a page, <!-- name --> and <!-- /name -->: results that an experiment writes in place."""

from pathlib import Path

ROOT = Path(__file__).parents[1]


def put(page: Path, name: str, text: str) -> None:
    """Replace what stands between the markers of that name.

    Raises:
        ValueError: if the page does not have both, in this order, once.
    """
    whole = page.read_text()
    start, end = f"<!-- {name} -->", f"<!-- /{name} -->"
    before, found, rest = whole.partition(start)
    _, closed, after = rest.partition(end)
    if not found or not closed or whole.count(start) + whole.count(end) != 2:
        raise ValueError(f"{page} must have {start} and {end}, once each")
    page.write_text(f"{before}{start}\n{text.strip()}\n{end}{after}")
