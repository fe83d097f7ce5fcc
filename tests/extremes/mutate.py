#!/usr/bin/env python3
"""Tries the mutations of `mutations.tsv`: each is one changed expression that must turn its test red.

usage: tests/extremes/mutate.py [TEXT..]     those alone whose test or file holds one of the texts

All of them are built at once into a copy of the sources, each behind a number that is read when the program runs, so
one build a crate does for all. `CARGO_TARGET_DIR` may name a folder of builds to reuse, but not a checkout's own `target`: cargo
would take mutated tests for those of the checkout. `CARGO` may name another cargo. Fails where
a test is red without a mutation, or green with one. A test that does not end within four CPU-minutes, or half
an hour, is red.
"""
import json
import os
import pathlib
import re
import resource
import shutil
import subprocess
import sys
import tempfile

HERE = pathlib.Path(__file__).resolve().parent
ROOT = HERE.parents[1]
CARGO = os.environ.get("CARGO", "cargo").split()
SWITCH = """
#[allow(missing_docs, unreachable_pub)]
pub fn mutant(number: u32) -> bool {
    static ON: std::sync::OnceLock<Option<String>> = std::sync::OnceLock::new();
    ON.get_or_init(|| std::env::var("MUTANT").ok()).as_deref() == Some(number.to_string().as_str())
}
"""


def find(text, wanted):
    """Positions of the characters of `wanted` in a text, ignoring white space; it must occur once."""
    places = [at for at, char in enumerate(text) if not char.isspace()]
    bare = "".join(text[at] for at in places)
    wanted = re.sub(r"\s", "", wanted)
    assert bare.count(wanted) == 1, f"{wanted} occurs {bare.count(wanted)} times"
    first = bare.index(wanted)
    return places[first:first + len(wanted)]


def span(text, before):
    """Start and end of the part of `before` between « and », or of all of it."""
    head, _, rest = before.partition("«") if "«" in before else ("", "", before)
    part, _, tail = rest.partition("»")
    places = find(text, head + part + tail)
    count = [len(re.sub(r"\s", "", piece)) for piece in (head, part)]
    return places[count[0]], places[count[0] + count[1] - 1] + 1


def switched(text, changes):
    """The text with every change behind its number; `changes` are (number, before, after)."""
    spans = {}
    for number, before, after in changes:
        spans.setdefault(span(text, before), []).append((number, after))
    for (start, end), several in sorted(spans.items(), reverse=True):
        own = text[start:end]
        branches = "".join(f"if crate::mutant({number}) {{ {after} }} else " for number, after in several)
        branches += f"{{ {own} }}"
        text = text[:start] + (branches if own.endswith(";") else f"({branches})") + text[end:]
    return text


def target_of(test):
    """The crate and the set of tests that a test belongs to, by its file."""
    found = subprocess.run(["git", "grep", "-l", f"fn {test}("], cwd=ROOT, capture_output=True, text=True)
    [file] = found.stdout.split()
    crate, kind, name, *_ = file.removeprefix("extras/").split("/")
    return crate, ["--lib"] if kind == "src" else ["--test", name.removesuffix(".rs")]


def folder(root, crate):
    """The folder of a crate."""
    return next(path for path in [pathlib.Path(root, crate), pathlib.Path(root, "extras", crate)] if path.is_dir())


def build(copy, crate, which):
    """The program with a set of tests."""
    command = [*CARGO, "test", "--release", "--no-run", "--message-format=json-render-diagnostics", "-p", f"lightharmony-{crate}", *which]
    done = subprocess.run(command, cwd=copy, stdout=subprocess.PIPE, text=True, check=True)
    made = [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]
    [program] = [message["executable"] for message in made if message.get("executable")]
    # Another build into the same folder must not take its place.
    return shutil.copy(program, pathlib.Path(copy, f"{crate}-tests"))


def passes(program, crate, test, number):
    """Whether a test passes while a mutation is on."""
    environment = dict(os.environ, MUTANT=str(number))
    try:
        done = subprocess.run([program, test], cwd=folder(ROOT, crate), env=environment, capture_output=True, text=True,
                              preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_CPU, (240, 240)), timeout=1800)
    except subprocess.TimeoutExpired:
        return False
    assert done.returncode != 0 or " 0 passed" not in done.stdout, f"there is no test {test}"
    return done.returncode == 0


def main():
    rows = [line.split("\t") for line in (HERE / "mutations.tsv").read_text().splitlines()]
    chosen = [(n, row) for n, row in enumerate(rows, 1)
              if len(sys.argv) == 1 or any(text in row[0] or text in row[1] for text in sys.argv[1:])]
    wrong = []
    with tempfile.TemporaryDirectory() as copy:
        for file in subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True).stdout.splitlines():
            to = pathlib.Path(copy, file)
            to.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(ROOT / file, to)
        for file in sorted({file for _, (_, file, _, _) in chosen}):
            path = pathlib.Path(copy, file)
            changes = [(n, before, after) for n, (_, of, before, after) in chosen if of == file]
            path.write_text(switched(path.read_text(), changes))
        for crate in sorted({file.removeprefix("extras/").split("/")[0] for _, (_, file, _, _) in chosen}):
            with open(folder(copy, crate) / "src/lib.rs", "a") as lib:
                lib.write(SWITCH)
        programs = {}
        for test in sorted({test for _, (test, *_) in chosen}):
            crate, which = target_of(test)
            programs[test] = programs.get((crate, *which)) or build(copy, crate, which)
            programs[crate, *which] = programs[test]
            if not passes(programs[test], crate, test, 0):
                wrong.append(f"{test} is red without a mutation")
        for number, (test, file, before, after) in chosen:
            red = not passes(programs[test], target_of(test)[0], test, number)
            print(f"{'red' if red else 'GREEN'}\t{test}\t{file}\t{before}\t{after}", flush=True)
            if not red:
                wrong.append(f"{test} is green with `{before}` changed to `{after}` in {file}")
    print(f"{len(chosen)} mutations, {len(wrong)} not as they should be", *wrong, sep="\n", file=sys.stderr)
    return bool(wrong)


if __name__ == "__main__":
    sys.exit(main())
