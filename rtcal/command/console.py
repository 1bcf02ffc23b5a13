"""What all commands share: ``--quiet``, ``--json``, and how they speak."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from importlib.util import find_spec
from typing import Any

import click
import numpy as np

quiet_option = click.option("--quiet", "-q", is_flag=True, help="Print nothing but errors.")
json_option = click.option("--json", "as_json", is_flag=True, help="Print JSON in place of text.")

WRITTEN = ("room.toml", "result.json", "reverberation_time.png")
"""What `calibrate` writes into its folder."""


def tell(text: str, record: Mapping[str, Any], *, quiet: bool, as_json: bool) -> None:
    """Print a text, or with ``--json`` the record of the same; nothing with ``--quiet``."""
    if not quiet:
        click.echo(json_text(record) if as_json else text)


def json_text(record: Mapping[str, Any]) -> str:
    """Return a record as JSON; arrays as lists, missing numbers as null."""
    return json.dumps(_plain(record), indent=1, ensure_ascii=False, allow_nan=False)


def bar_wanted(quiet: bool) -> bool:
    """Whether to show a progress bar: someone looks at a terminal, and tqdm is there to draw it."""
    return not quiet and sys.stderr.isatty() and find_spec("tqdm") is not None


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, np.ndarray):
        if value.dtype.names:  # a table: one object a row
            return [dict(zip(value.dtype.names, _plain(list(row)), strict=True)) for row in value]
        return _plain(value.tolist())
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not np.isfinite(value) else value
