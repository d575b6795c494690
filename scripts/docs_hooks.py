"""What mkdocs shows of docstrings: names in place of Sphinx roles, and lines of examples kept."""

from __future__ import annotations

import re
from typing import Any

ROLE = re.compile(r":(?:attr|class|func|meth|mod):<code>(~?)\.*([^<]*)</code>")
"""A role; of a name with ``~`` before it the last part is shown."""
EXAMPLE = re.compile(r"<p>\\b\n(.*?)</p>", re.DOTALL)
"""A paragraph that click does not wrap."""


def on_page_content(html: str, **_: Any) -> str:
    """The page with these replaced."""
    named = ROLE.sub(
        lambda found: f"<code>{found[2].rpartition('.')[2] if found[1] else found[2]}</code>", html
    )
    return EXAMPLE.sub(r"<pre><code>\1</code></pre>", named)
