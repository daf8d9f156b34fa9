"""Pieces of Markdown."""

from collections.abc import Iterable, Sequence


def table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Lay out rows of cells under a header."""
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def paragraphs(*texts: str) -> str:
    """Join texts as paragraphs of one line each."""
    return "\n\n".join(" ".join(text.split()) for text in texts)


def bullets(*texts: str) -> str:
    """List texts, one line each."""
    return "\n".join("* " + " ".join(text.split()) for text in texts)
