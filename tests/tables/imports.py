#!/usr/bin/env python3
"""Prints the table of docs/evidence/engine.md: files, imports, circles and lengths of the crates of a checkout.

    tests/tables/imports.py [CHECKOUT]

Imports are read as by tests/support/arrows.rs: paths below `crate::`, `super::` and `self::` and below the modules that a
file declares, in code, without unit tests. Product code
is everything but tests, benches, fuzz targets and extras.
"""

import os
import re
import sys

CRATES = {"cache": "cache/src", "engine": "engine/src", "scene": "scene/src", "render": "render/src", "nodes": "nodes/src", "trade": "trade/src", "benchmark": "benchmark/src", "program": "src"}
TEST = re.compile(r"#\[cfg\(test\)\]\n(?:#\[[^\n]*\n)*(?:pub\(crate\) )?mod \w+ \{")


def files(src):
    """The product code of each file below a folder, by module path."""
    found = {}
    for folder, inner, names in os.walk(src):
        inner[:] = sorted(name for name in inner if name != "tests")
        for name in sorted(names):
            if name.endswith(".rs") and name not in ("tests.rs", "testing.rs"):
                with open(os.path.join(folder, name)) as file:
                    module = os.path.relpath(os.path.join(folder, name), src)[:-3].removesuffix("/mod")
                    found[module] = TEST.split(file.read())[0]
    return found


def tree(text, above, paths):
    """Reads one tree of a `use` item and gives what is left behind it."""
    text = text.lstrip()
    if text.startswith("{"):
        rest = text[1:]
        while rest := rest.lstrip(", \n"):
            if rest.startswith("}"):
                return rest[1:]
            rest = re.sub(r"^[\w ]*", "", tree(rest, above, paths))
        return rest
    word = re.match(r"[\w*]*", text).group()
    if not word:
        return text[1:]
    path = above + [word]
    if text[len(word):].startswith("::"):
        return tree(text[len(word) + 2:], path, paths)
    paths.append(path)
    return text[len(word):]


def imports(module, text, known):
    """The modules that a file names."""
    code, paths = re.sub(r"//[^\n]*|pub\(in [^)]*\)", "", text), []
    for at in re.finditer(r"(?<![\w$])crate::", code):
        tree(code[at.end():], [], paths)
    for at in re.finditer(r"(?<!super::)(?:super::)+", code):
        above = module.split("/")[: -len(at.group()) // len("super::")]
        tree(code[at.end():], above, paths)
    inside = "" if module in ("lib", "main") else "|self"
    children = "|".join(re.findall(r"^(?:pub(?:\([^)]*\))? )?mod (\w+);", code, re.M)) + inside
    for at in re.finditer(rf"(?<![\w:$])(?:{children})::", code) if children else ():
        # `self` is the file's own module.
        start = at.end() if at.group() == "self::" else at.start()
        tree(code[start:], [] if module in ("lib", "main") else module.split("/"), paths)
    for path in paths:
        names = ("/".join(path[:length]) for length in range(len(path), 0, -1))
        name = next((name for name in names if name in known), module)
        if name != module:
            yield name


def circles(arrows):
    """Sizes of the groups of modules that import each other, the largest first."""
    def reached(start):
        seen, left = set(), [start]
        while left:
            for name in arrows[left.pop()] - seen:
                seen.add(name)
                left.append(name)
        return seen

    reach = {name: reached(name) for name in arrows}
    groups = {frozenset(other for other in reach[name] if name in reach[other]) for name in arrows if name in reach[name]}
    if os.environ.get("CIRCLES"):
        for group in sorted(map(sorted, groups)):
            edges = ", ".join(f"{a.removeprefix(group[0])} -> {b.removeprefix(group[0])}" for a in group for b in sorted(arrows[a]) if b in group)
            print(f"{group[0]}: {edges}", file=sys.stderr)
    return sorted(map(len, groups), reverse=True)


def functions(text):
    """Lengths of the functions of a file in lines."""
    lines = text.split("\n")
    for at, line in enumerate(lines):
        if head := re.match(r"( *)(?:pub(?:\([^)]*\))? )?(?:const |unsafe )*fn \w", line):
            closes = (i for i in range(at, len(lines)) if lines[i].startswith(head.group(1) + "}") or i == at and line.endswith(("}", ";")))
            yield next(closes, at) - at + 1


def main():
    root = sys.argv[1] if len(sys.argv) > 1 else "."
    of = lambda list, share: sorted(list)[int(len(list) * share)]
    print("| crate | files | most in one folder | imports | circles | lines | file: median, p90 | function: median, p90, most |")
    print("|---|---|---|---|---|---|---|---|")
    total = [0, 0]
    for crate, src in CRATES.items():
        if not (found := files(os.path.join(root, src))):
            continue
        arrows = {module: set(imports(module, text, found)) for module, text in found.items()}
        folders = [os.path.dirname(module) for module in found]
        lengths = [text.count("\n") for text in found.values()]
        code = [length for text in found.values() for length in functions(text)]
        groups = ", ".join(map(str, circles(arrows))) or "none"
        total = [total[0] + len(found), total[1] + sum(lengths)]
        print(f"| {crate} | {len(found)} | {max(map(folders.count, folders))} | {sum(map(len, arrows.values()))} | {groups} | {sum(lengths):,}"
              f" | {of(lengths, 0.5)}, {of(lengths, 0.9)} | {of(code, 0.5)}, {of(code, 0.9)}, {max(code)} |")
    print(f"\n{total[0]} files, {total[1]:,} lines")


if __name__ == "__main__":
    main()
