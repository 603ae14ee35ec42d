"""What the commands share: where results go, bars on a terminal, and figures in mm and mrad."""

import sys

from rig.errors import RigError

SEED = 0  # of the bootstrap; results are the same from run to run


class Progress:
    """Bars on a terminal, nothing in a pipe: called with (label, done, of)."""

    def __init__(self):
        self.bar, self.label = None, None

    def __call__(self, label, done, of):
        from tqdm import tqdm

        if label != self.label:
            self.close()
            self.bar, self.label = tqdm(total=of, desc=label, disable=None, leave=False, file=sys.stderr), label
        self.bar.update(done - self.bar.n)
        if done >= of:
            self.close()

    def close(self):
        """Take the bar away."""
        if self.bar is not None:
            self.bar.close()
        self.bar, self.label = None, None


def fresh_folder(path, source=None):
    """The folder path, made if need be. Raises RigError where it is a file, cannot be made, or is the folder `source`."""
    if path.exists() and not path.is_dir():
        raise RigError(f"{path} is a file; --out names a folder")
    if source is not None and path.resolve() == source.resolve():
        raise RigError(f"--out is the recording itself; it stays as it was, name another folder than {path}")
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RigError(f"{path} cannot be made: {error.strerror}") from None
    return path


def fresh_file(path, source=None):
    """The path of a file to write. Raises RigError for a folder, a folder that is not there, or a file of the recording `source`."""
    if path.is_dir():
        raise RigError(f"{path} is a folder; --out names a file")
    if not path.parent.is_dir():
        raise RigError(f"{path.parent} is no folder; make it first")
    if source is not None and path.parent.resolve() == source.resolve() and path.suffix in (".csv", ".toml"):
        raise RigError(f"--out {path} is a file of the recording, which stays as it was; name another")
    return path


def print_comparison(held, title):
    """Print a HeldOut as a table in mm and mrad."""
    names = ("mean", "RMS", "95 %", "max")
    print(f"{title}, N = {held.after.n}:")
    print(f"{'':14}{'position, mm':>40}{'rotation, mrad':>43}")
    print(f"{'':14}" + "".join(f"{name:>10}" for name in names) + "   " + "".join(f"{name:>10}" for name in names))
    for name, figures in (("owner's model", held.before), ("corrected", held.after)):
        position, rotation = (figures.mean[0], *figures.position), (figures.mean[1], *figures.rotation)
        print(f"{name:14}" + "".join(map(_cell, position)) + "   " + "".join(map(_cell, rotation)))
    rotation = f" and {held.floor[1] * 1e3:.4f} mrad" if held.floor[1] < 1 else "; rotations were not measured"
    print(f"{held.ratio[0]:.1f} times better (95 % interval {held.ratio[1]:.1f} to {held.ratio[2]:.1f}); the measured poses themselves are "
          f"uncertain by {held.floor[0] * 1e3:.4f} mm{rotation}")


def _cell(value):
    return f"{value * 1e3:10.4f}" if value == value else f"{'-':>10}"


def print_unsolved(measured):
    """Print the frames of a Measurement that have no pose, with their reasons."""
    if measured is None or not measured.unsolved:
        return
    print(f"{len(measured.unsolved)} frames without a pose:")
    for frame, reason in sorted(measured.unsolved.items())[:20]:
        print(f"  frame {frame}: {reason}")
    if len(measured.unsolved) > 20:
        print(f"  and {len(measured.unsolved) - 20} more")
