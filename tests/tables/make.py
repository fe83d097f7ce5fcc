#!/usr/bin/env python3
"""Makes the tables of the docs.

usage: make.py [--data DIR] [--work DIR] [NAME..]      default: ../shared/data, a new folder, all tables whose needs are met
       make.py --try [NAME..]                          the smallest form of each job, whose tables go nowhere
       make.py --list                                  the tables, with their time and needs

The program is that of target/release, or of LIGHTHARMONY; benches are built by cargo, or lie in the folder
LIGHTHARMONY_BENCHES. `tune` takes references that `presets` made in the same folder.

Every command prints markdown tables, which are kept below the folder as NAME.md; each takes the place of the table in the
page with the same first row (of several in their order), with a line that names the command and the commit. The text
around them is not changed: read it again. Failures are reported at the end, and the rest is made. Deterministic
counts are not made here but guarded by tests (tests/tables/counts.tsv, which UPDATE_GOLDEN=1 cargo test --release renews).
"""
import argparse, os, shutil, sys, tempfile, time

from curves import curves
from job import Failed, HERE, Job, ROOT, cpu
from page import renew
from trade import bad, presets, tune

# Name: pages, seeds or None, CPU-minutes on an idle machine, what it needs in addition to the program (below the data, or a command),
# the function that makes its tables, and whether it has a small form.
def tables(job):
    trade, small = ["docs/evidence/trade.md"], ["small"] * job.small
    traced = lambda: curves(job.bench("trace", job.data, "plane", "ratio", *small), job.picture("trace"))
    return {
        "weights": (trade, 7, 3, None, lambda: job.script("weights"), True),
        "errors": (trade, 7, 3, "render-refs", lambda: job.script("errors", job.data), True),
        "skips": (trade, 3, 3, None, lambda: job.script("skips"), True),
        "bad": (trade, 3, 1, None, lambda: bad(job), True),
        "presets": (trade, "7 and 1", 9, "bench-case", lambda: presets(job), True),
        "coverage": (trade, "0 to 19", 8, "bench-case", lambda: job.bench("coverage", *small), True),
        "bench_case": (["README.md", "docs/evidence/bench.md"], 1, 10, "bench-case", lambda: job.script("bench_case", job.data), True),
        "ablations": (["docs/evidence/light-transport.md", "docs/evidence/bench.md"], 1, 5, "bench-case", lambda: job.script("ablations", job.data), True),
        "tune": (trade, "7, 1, 7 and 3", 15, "splats/garden_sog", lambda: tune(job), True),
        "extremes": ([], None, 2, None, lambda: job.call("tests/extremes/page"), False),
        "splats": (["docs/evidence/splats.md"], None, 5, "splats/garden_sog", lambda: job.bench("splat", job.data), False),
        "trace": (["docs/evidence/trace.md", "docs/evidence/light-transport.md"], "7 and 1 to 3", 3, "render-refs", traced, True),
        "noop": (["docs/evidence/bench.md"], None, 4, "ninja", lambda: job.call("python3", "tests/noop/ninja.py", job.program, "ninja", job.path("noop")), False),
    }

# Files that affect the content of a table: all but the pages that tables go to.
ALL_BUT_PAGES = ["--", ".", ":!docs", ":!README.md"]

def missing(data, needs):
    """The missing requirement of a table; None if there is none."""
    there = needs is None or (shutil.which(needs) if needs == "ninja" else os.path.exists(os.path.join(data, needs)))
    return None if there else needs

def main():
    parse = argparse.ArgumentParser(usage=__doc__)
    parse.add_argument("--data", default=os.path.join(ROOT, "../shared/data"))
    parse.add_argument("--work")
    parse.add_argument("--list", action="store_true")
    parse.add_argument("--try", action="store_true", dest="small")
    parse.add_argument("names", nargs="*")
    asked = parse.parse_args()
    program = os.path.abspath(os.environ.get("LIGHTHARMONY", os.path.join(ROOT, "target/release/lightharmony")))
    benches = os.environ.get("LIGHTHARMONY_BENCHES")
    job = Job(program, benches and os.path.abspath(benches), os.path.abspath(asked.data), os.path.abspath(asked.work or tempfile.mkdtemp()), asked.small)
    known = tables(job)
    unknown = [name for name in asked.names if name not in known]
    if unknown:
        sys.exit(f"there are no tables {unknown}; there are {', '.join(known)}")
    if asked.list:
        for name, (pages, _, minutes, needs, *_) in known.items():
            lacks = f", which is not here: {needs}" if missing(job.data, needs) else f", needs {needs}" if needs else ""
            print(f"{name:10} {', '.join(pages or ['docs/evidence/extremes.md']):38} about {minutes:2} CPU-min{lacks}")
        return
    if not os.path.exists(program):
        sys.exit(f"there is no program {program}: cargo build --release, or name one by LIGHTHARMONY")
    os.makedirs(job.work, exist_ok=True)
    commit = job.call("git", "rev-parse", "--short", "HEAD").strip() + ("+" if job.call("git", "status", "--short", "-uno", *ALL_BUT_PAGES) else "")
    results = []
    for name in asked.names or known:
        pages, seed, _, needs, make, has_small = known[name]
        lacks = missing(job.data, needs)
        if lacks or (job.small and not has_small):
            results.append((name, f"left out: there is no {lacks or 'small form of it'}"))
            continue
        begun, spent = time.monotonic(), cpu()
        try:
            text = make()
            job.write(f"{name}.md", text)
            if pages:
                seeded = f", seed{'s' * isinstance(seed, str)} {seed}" if seed is not None else ""
                renew(pages, text, f"*Made by `{HERE}/make.py {name}`, commit {commit}{seeded}.*", keep=job.small)
            how = "made"
        # A failure of one table does not stop the others.
        except Exception as error:
            how = f"failed: {error if isinstance(error, Failed) else repr(error)}"
        results.append((name, f"{how}, after {time.monotonic() - begun:.0f} s and {cpu() - spent:.0f} CPU-s"))
        print(f"{name}: {results[-1][1]}", file=sys.stderr, flush=True)
    print(f"\nin {job.work}:", *(f"  {name:9} {how}" for name, how in results), sep="\n", file=sys.stderr)
    sys.exit(any(how.startswith("failed") for _, how in results))

if __name__ == "__main__":
    main()
