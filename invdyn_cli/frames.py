"""Tables of pandas, where pandas is installed."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from invdyn_cli.errors import UsageError

if TYPE_CHECKING:
    from pandas import DataFrame


def frame(columns: Mapping[str, Any], index: Sequence[str] = ()) -> "DataFrame":
    """A DataFrame of columns by name, of which those called `index` are its index.

    Raises:
        UsageError: if pandas is not installed.
    """
    try:
        import pandas as pd
    except ImportError as error:
        raise UsageError("to_pandas needs the library pandas", advice='pip install "invdyn[pandas]"') from error
    made = pd.DataFrame(dict(columns))
    return made.set_index(list(index)) if index else made
