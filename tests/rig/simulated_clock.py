"""A clock that nobody waits for, and the size of the images that cameras give by it."""

SIZE = (32, 24)  # px


class Ticking:
    """A clock that nobody waits for. due : [(s, what happens then)]"""

    def __init__(self, t=1000.0):
        self.t, self.due = t, []

    def now(self):
        return self.t

    def sleep(self, seconds):
        end = self.t + seconds
        for entry in sorted((e for e in self.due if e[0] <= end), key=lambda e: e[0]):
            self.due.remove(entry)
            self.t = max(self.t, entry[0])
            entry[1]()
        self.t = end
