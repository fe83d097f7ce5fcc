"""Tables in a page of the docs."""
import os

from job import Failed, ROOT

def blocks(lines):
    """(first, last + 1) of every table."""
    found, at = [], 0
    while at < len(lines):
        end = at
        while end < len(lines) and lines[end].startswith("|"):
            end += 1
        if end > at:
            found.append((at, end))
        at = max(end, at + 1)
    return found

def note_end(lines, end):
    """Where the note below a table ends, which is a paragraph in italics."""
    if lines[end:end + 1] != [""] or not lines[end + 1:end + 2] or not lines[end + 1].startswith("*"):
        return end
    last = end + 1
    while last < len(lines) and lines[last] and not lines[last].endswith("*"):
        last += 1
    return last + 1 if last < len(lines) and lines[last].endswith("*") else end

def renew(pages, text, note, keep=False):
    """Puts the tables of `text` in the places of those of some pages that have the same first row; with `keep` the pages stay
    as they are, and are only asked whether they have them."""
    fresh, made = {}, text.split("\n")
    for first, end in blocks(made):
        if end - first < 3:
            raise Failed(f"a table has no rows: {made[first]}")
        fresh.setdefault(made[first].replace(" ", ""), []).append(made[first:end])
    if not fresh:
        raise Failed("nothing was made")
    for page in pages:
        path = os.path.join(ROOT, page)
        with open(path) as file:
            lines = file.read().split("\n")
        for first, end in reversed(blocks(lines)):
            waiting = fresh.get(lines[first].replace(" ", ""))
            if waiting:
                lines[first:note_end(lines, end)] = waiting.pop() + ["", note]
        if not keep:
            with open(path, "w") as file:
                file.write("\n".join(lines))
    left = [head for head, waiting in fresh.items() if waiting]
    if left:
        raise Failed(f"{', '.join(pages)}: no table (or too few) of {left}")
