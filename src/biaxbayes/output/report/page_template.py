"""The templates of the pages; text that is put into them is escaped."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING

from biaxbayes.output.report.names import as_html

if TYPE_CHECKING:
    from jinja2 import Template

__all__ = ["page_template"]


@cache
def page_template(name: str) -> Template:
    """The template of a file beside this one."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("biaxbayes.output.report", "."),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["symbol"] = as_html
    return environment.get_template(name)
