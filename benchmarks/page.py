"""Pages and their figures; a script that imports it puts this folder on its path."""


def between(text: str, start: str, end: str, words: str) -> str:
    """Return a text with what stands between two markers replaced."""
    before, rest = text.split(start)
    _, after = rest.split(end)
    return f"{before}{start}\n\n{words}\n\n{end}{after}"
