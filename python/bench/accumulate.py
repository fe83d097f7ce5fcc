"""Renders a picture in passes until two halves agree, and continues where an earlier process stopped. NumPy only."""
import os

import numpy as np

from pictures import display


def rmse(a, b, mask=None):
    """RMSE of the display values, over all pixels or those of a mask."""
    d = (display(a) - display(b)) ** 2
    return float(np.sqrt((d if mask is None else d[mask]).mean()))


class Halves:
    """The sums of the even and of the odd passes. The state is stored after each pass."""

    def __init__(self, file):
        self.file, self.sums, self.passes = file, None, 0
        if os.path.exists(file):
            with np.load(file) as stored:
                self.sums, self.passes = stored["sums"], int(stored["passes"])

    def add(self, picture):
        picture = np.asarray(picture, np.float64)
        if self.sums is None:
            self.sums = np.zeros((2, *picture.shape))
        self.sums[self.passes % 2] += picture
        self.passes += 1
        draft = f"{self.file}.part.npz"
        np.savez(draft, sums=self.sums, passes=self.passes)
        os.replace(draft, self.file)

    def mean(self):
        return (self.sums[0] + self.sums[1]) / self.passes

    def difference(self, mask=None):
        """RMSE to expect between two pictures with independent seeds and as many samples as all passes have.

        It is that between the means of the halves, which have half of the samples each, over the square root of 2. The error
        of the mean of all passes is smaller by that factor once more. With a mask, the larger value of the picture and the
        mask. Infinite with fewer than two passes."""
        if self.passes < 2:
            return np.inf
        odd = self.passes // 2
        a, b = self.sums[0] / (self.passes - odd), self.sums[1] / odd
        whole = rmse(a, b)
        worst = whole if mask is None or not mask.any() else max(whole, rmse(a, b, mask))
        return worst / 2 ** 0.5


def converge(render, file, bound, limit, mask=None, seed=0, report=None):
    """Renders passes until `Halves.difference` is below `bound`, in whole pairs, at most `limit` passes.

    `render(seed)` gives one pass. Returns the mean, the difference that was reached and the number of passes."""
    halves = Halves(file)
    while halves.passes < 2 or halves.passes % 2 or (halves.difference(mask) > bound and halves.passes < limit):
        halves.add(render(seed + halves.passes))
        if report:
            report(halves.passes, halves.difference(mask))
    return halves.mean(), halves.difference(mask), halves.passes
