"""What `write-report` wrote as markdown."""

def rows(path):
    """The rows of the first table that has views, pictures and regions, by column."""
    with open(path) as file:
        lines = [[cell.strip() for cell in line.strip("|\n").split("|")] for line in file if line.startswith("| ")]
    head = next(line for line in lines if line[:3] == ["view", "picture", "region"])
    return [dict(zip(head, line)) for line in lines if len(line) == len(head) and line != head]

def decibels(rows, picture, region):
    """PSNR of a picture in a region, of all views."""
    found = [row["psnr (dB)"] for row in rows if row["picture"] == picture and row["region"] == region]
    return " / ".join(f"{float(value):.1f}" for value in found)
