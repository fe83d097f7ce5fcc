"""Checks whether the scores of `lightharmony bench` rank known faults and the pairs of pairs.tsv rightly.

    venv/bin/python python/bench/ranking.py SET PROGRAM WORK CASE [CASE ..]

Makes the pictures of distortions.py for the cases, scores them as pictures of other methods, and prints Markdown tables.
A fault counts as ranked if its four strengths are in order in a view, and a pair if the better picture has the better score.
"""
import csv
import pathlib
import subprocess
import sys

import distortions
import pictures

METRICS = {"PSNR (dB)": 1, "SSIM": 1, "FLIP": -1, "CIEDE2000": -1, "log-ratio error": -1, "shadow IoU": 1}
"""Metrics, and 1 if a larger value is better."""
REGIONS = {"shadow": "shadow", "object": "object", "reflection": "reflection", "background": "rest"}
"""Region that a fault changes, by the first word of its name."""


def make(case, out):
    """Writes OUT/RECIPE/CASE/VIEW.png for all faults, strengths and pairs."""
    for view in distortions.json.loads((case / "case.json").read_text())["views"]:
        truth = distortions.Truth(case, view)
        for name, recipe in distortions.recipes().items():
            folder = out / name.replace("_", "-") / case.name
            folder.mkdir(parents=True, exist_ok=True)
            pictures.write_png(folder / f"{view}.png", pictures.codes(distortions.distorted(truth, recipe)))


def scores(path):
    """Value by picture, case, view, region and metric."""
    found = {}
    for row in csv.DictReader(path.open()):
        for metric in METRICS:
            if row.get(metric):
                found[row["picture"], row["case"], row["view"], row["region"], metric] = float(row[metric])
    return found


def ordered(values, sign):
    """True if each value is worse than the one before it."""
    return all(sign * (a - b) > 0 for a, b in zip(values, values[1:]))


def main():
    base, program, work = pathlib.Path(sys.argv[1]), sys.argv[2], pathlib.Path(sys.argv[3])
    cases = sys.argv[4:]
    for case in cases:
        make(base / case, work / "methods")
    subprocess.run([program, "bench", base, "--methods", work / "methods", "--case", ",".join(cases), "--samples", "4",
                    "--out", work / "bench"], check=True, stdout=subprocess.DEVNULL)
    found = scores(work / "bench/scores.csv")
    views = sorted({key[1:3] for key in found})

    def value(name, place, region, metric):
        return found.get((name.replace("_", "-"), *place, region, metric))

    columns = [(region, metric) for metric in METRICS for region in ("its region", "whole")
               if region == "its region" or metric not in ("log-ratio error", "shadow IoU")]
    heads = [f"{metric}, {region}" for region, metric in columns]
    print(f"Views whose four strengths are in order, of those in which the fault changes the region (views: {len(views)}).\n")
    print("| fault | " + " | ".join(heads) + " |\n|" + "---|" * (len(heads) + 1))
    totals = [[0, 0] for _ in columns]
    for fault in distortions.FAULTS:
        cells = []
        for total, (region, metric) in zip(totals, columns):
            region = REGIONS[fault.split("_")[0]] if region == "its region" else region
            right = all_views = 0
            for place in views:
                values = [value(f"{fault}-{s}", place, region, metric) for s in distortions.STRENGTHS]
                if None not in values and len(set(values)) > 1:
                    all_views += 1
                    right += ordered(values, METRICS[metric])
            total[0] += right
            total[1] += all_views
            cells.append(f"{right} / {all_views}" if all_views else "")
        print(f"| {fault} | " + " | ".join(cells) + " |")
    print("| all | " + " | ".join(f"{a} / {b}" for a, b in totals) + " |\n")

    print("Pairs in which the better picture has the better score, over pairs and views.\n")
    print("| metric | whole picture | mean of object and shadow | wrong by the whole picture |\n|---|---|---|---|")
    for metric in ("PSNR (dB)", "SSIM", "FLIP", "CIEDE2000"):
        counts, wrong = {}, []
        for name, regions in (("whole", ["whole"]), ("parts", ["object", "shadow"])):
            right = 0
            for row in distortions.pairs():
                for place in views:
                    better, worse = (sum(value(f"pair-{row['pair']}-{which}", place, region, metric) for region in regions)
                                     for which in ("better", "worse"))
                    good = METRICS[metric] * (better - worse) > 0
                    right += good
                    if name == "whole" and not good:
                        wrong.append(f"{row['better']} against {row['worse']}")
            counts[name] = right
        n = len(distortions.pairs()) * len(views)
        listed = ", ".join(f"{text} ({wrong.count(text)})" for text in dict.fromkeys(wrong)) or "none"
        print(f"| {metric} | {counts['whole']} / {n} | {counts['parts']} / {n} | {listed} |")


if __name__ == "__main__":
    main()
