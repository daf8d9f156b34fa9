"""What mkdocs does to a page beyond its plugins: pages read alike in the repository and here."""

from __future__ import annotations

import html
import re
from pathlib import Path, PurePosixPath
from typing import Any

from latex2mathml.converter import convert

_LINK = re.compile(r"(?<!!)\[(?P<words>[^\]]+)\]\((?P<target>[^)#:]+)(?P<anchor>#[^)]*)?\)")
_FORMULA = re.compile(r'<(span|div) class="arithmatex">\\[(\[](.*?)\\[)\]]</\1>', re.DOTALL)
_TAG = re.compile(r"\\tag\{(\w+)\}")


def on_page_markdown(markdown: str, page: Any, config: Any, **_: Any) -> str:
    """Turn links to files of the repository outside the documentation into their names."""
    docs = Path(config["docs_dir"])
    if page.file.src_uri == "contributing.md":  # one text, which stands at the top
        text = (docs.parent / "CONTRIBUTING.md").read_text("utf-8")
        markdown = re.sub(r"\]\((?!\w+:)", "](../", text).replace("](../docs/", "](")

    def shown(link: re.Match[str]) -> str:
        folder = PurePosixPath(page.file.src_uri).parent
        target = (docs / folder / link["target"]).resolve()
        if target.is_relative_to(docs):
            return link[0]
        if config["repo_url"]:
            path = target.relative_to(docs.parent).as_posix()
            return f"[{link['words']}]({config['repo_url'].rstrip('/')}/blob/HEAD/{path})"
        return link["words"]

    return _LINK.sub(shown, markdown)


def on_page_content(content: str, **_: Any) -> str:
    """Turn formulas into MathML: browsers draw it themselves, without scripts from elsewhere."""

    def drawn(formula: re.Match[str]) -> str:
        kind, tex = formula[1], html.unescape(formula[2])
        number = _TAG.search(tex)
        # `aligned`, which others ask for, would lose its rows.
        tex = _TAG.sub("", tex).replace("{aligned}", "{align*}")
        shown = convert(tex, display="block" if kind == "div" else "inline")
        if kind == "span":
            return shown
        label = f'<span class="number">({number[1]})</span>' if number else ""
        return f'<div class="formula">{shown}{label}</div>'

    return _FORMULA.sub(drawn, content)
