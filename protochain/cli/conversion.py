"""Values of options that need no conversion. Typer imports Pydantic, which takes 7 % of a short run."""

import os
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any


class PlainValues:
    """Base of commands that convert plain values themselves. Typer converts the rest, and reports errors."""

    def get_params(self, ctx: Any) -> list[Any]:
        """Return all parameters, the help option included."""
        params: list[Any] = super().get_params(ctx)  # type: ignore[misc]  # of the other base
        for param in params:
            param.process_value = partial(_process, param)
        return params


def _process(param: Any, context: Any, value: Any) -> Any:
    for plain in _plain(param, value):
        return param.callback(context, param, plain) if param.callback else plain
    return type(param).process_value(param, context, value)


def _plain(param: Any, value: Any) -> Iterator[Any]:
    """Yield the converted value if it is plain."""
    kind = param.type_descriptor.annotation
    texts = [value] if type(value) is str else value if kind == list[str] and value else []
    if value is None and not param.required:
        yield () if param.multiple or param.nargs == -1 else None
    # Typer refuses text that is not valid Unicode, and files that cannot be read.
    elif all(type(text) is str and text.isascii() for text in texts):
        if type(value) is kind:
            yield value
        elif texts and kind == list[str]:
            yield [*texts]
        elif texts and kind is Path and (os.access(value, os.R_OK) or not os.access(value, os.F_OK)):
            yield Path(value)
