"""Staged outputs of a command, protected against overwriting.

No foreign file is overwritten unless forced; all are moved to their places when complete.
"""

import os
from collections.abc import Iterable
from pathlib import Path

from rig.errors import FileError, RigError
from rig.formats import local_and_remote_input_files
from rig.formats.output_files.atomic_file_writing_and_process_locks import (
    HeldLock,
    is_path_written_without_staging,
    path_status,
    write_text,
)
from rig.formats.output_files.staged_folder_and_manifest import (
    GROWING,
    MANIFEST,
    FolderManifest,
    FolderOrigin,
    StagedFolder,
    is_recording_table,
    load_manifest,
    lock_unused_folder,
    remove_staged_files_of_killed_commands,
)


class CommandOutputs:
    """The places that one command writes to. As a context it puts everything there at its end, or nothing where an
    exception ends it.

    command : its name; inputs : paths that it reads, which are never written over; force : whether to write over what
        it did not make
    arguments : what the manifests say it was called with; a command may set fewer; data : marks of what it computed
        from, for them too
    in_use : whether the command has begun to write any file
    """

    def __init__(
        self, command: str, arguments: Iterable[str] = (), inputs: Iterable[Path] = (), force: bool = False
    ) -> None:
        self.command, self.arguments, self.inputs, self.force = command, tuple(arguments), list(inputs), force
        self.data: tuple[str, ...] = ()
        self.pages: list[Path] = []  # that are in their places by now
        self._staged: dict[Path, StagedFolder] = {}
        self._growing: list[tuple[Path, HeldLock]] = []
        self.in_use = False

    def __enter__(self) -> "CommandOutputs":
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, *_: object) -> None:
        try:
            if kind is None:
                self.finish()
            for folder in [folder for folder, _ in self._growing]:
                if kind is None:
                    write_text(
                        folder / MANIFEST, FolderManifest(self._origin(True), load_manifest(folder).files).text()
                    )
                    self.pages += folder.glob("*.html")
        finally:
            if isinstance(error, FileError):
                error.args = (self._as_named(str(error)),)
            for staged in self._staged.values():
                staged.discard()
            for folder, lock in self._growing:
                (folder / GROWING).rmdir()
                lock.close()

    def _as_named(self, text: str) -> str:
        """A message with the places where files would have been, not where they waited."""
        for staged in self._staged.values():
            text = text.replace(f"{staged.folder}{os.sep}", f"{staged.place}{os.sep}")
        return text

    def finish(self) -> None:
        """Put everything staged so far in its place now, not at the command's end; what is written after that needs a
        place anew.
        """
        for place, staged in tuple(self._staged.items()):
            pages = [place / path.relative_to(staged.folder) for path in staged.folder.rglob("*.html")]
            staged.commit(self._origin(True), self.inputs, self.force)
            self.pages += pages
            del self._staged[place]
            staged.discard()

    def folder(self, path: Path) -> Path:
        """Where to write the files of a folder that this command makes whole: they are at `path` once the command is
        done.

        Nothing of what the command left there before stays. Raises RigError for a file, for an input, for a folder that
        holds what this command did not make or what was changed since (unless forced) and where nothing can be written
        """
        _here(path)
        self._no_input(path, "the recording itself")
        if path.exists() and not path.is_dir():
            raise RigError(f"{path} is a file; --out names a folder")
        staged = self._staged_folder(Path(os.path.realpath(path)), path)
        if not self.force and not staged.whole:
            self._own(path)
        for given in self.inputs:
            real = Path(os.path.realpath(given))
            if staged.place in real.parents and real.relative_to(staged.place).as_posix() in staged.known.files:
                raise RigError(
                    f"{path} holds {given}, which this command reads; it remains unchanged, name another folder"
                )
        staged.whole = True
        staged.mark(self._origin(False))
        return staged.folder

    def file(self, path: Path, own: bool = False) -> Path:
        """Where to write a file: it is at `path` once the command is done. A non-regular file is written straight
        to.

        own : whether the command itself sees to it that a file that is there is its own, as one that goes on from a
            state does
        Raises RigError for a folder, for a file in a folder that is not there, for an input, for a file that this
        command did not make or that was changed since (unless forced), and where it cannot be written
        """
        _here(path)
        if is_path_written_without_staging(path):
            if not os.access(path, os.W_OK):
                raise FileError(path, "cannot be written: Permission denied")
            return path
        if path.is_dir():
            raise RigError(f"{path} is a folder; name a file to write")
        if not own:
            self._no_input(path, "what this command reads")
        place = Path(os.path.realpath(path))
        if not place.parent.is_dir() and place.parent not in self._staged:
            raise RigError(f"{path.parent} is no folder; create it first")
        if is_recording_table(place.name) and any(
            place.parent == Path(os.path.realpath(given)) for given in self.inputs
        ):
            raise RigError(f"{path} is a file of the recording, which remains unchanged; name another")
        staged = self._staged_folder(place.parent, path)
        if (
            place.exists()
            and not self.force
            and not own
            and not staged.known.untouched(place.parent, place.name, self.command)
        ):
            made = staged.known.files.get(place.name)
            raise FileError(
                path,
                f"was changed since `rig {self.command}` wrote it; name another file, or write over it with --force"
                if made is not None and made.command == self.command
                else f"is there and was not made by `rig {self.command}`; name another file, or write over it "
                "with --force",
            )
        if place.exists() and not os.access(place, os.W_OK):
            raise FileError(path, "cannot be written: Permission denied")
        if own or self.force:
            staged.allowed.add(place.name)
        return staged.folder / place.name

    def stage_file(self, file: Path, suffix: str) -> Path | None:
        """Where to write what accompanies a file that `file` gave, under its name with another suffix; None for what is
        no regular file.
        """
        staged = next((staged for staged in self._staged.values() if staged.folder == file.parent), None)
        return None if staged is None else self.file(staged.place / Path(file.name).with_suffix(suffix))

    def growing(self, path: Path, own: bool = False) -> Path:
        """A folder that is written in place, bit by bit, and goes on where it was interrupted; until the command's end
        it is marked as not
        complete, and no other command writes there. own : whether what is there is this command's, even unmarked.
        Raises as `folder` does"""
        _here(path)
        self._no_input(path, "what this command reads")
        if path.exists() and not path.is_dir():
            raise RigError(f"{path} is a file; --out names a folder")
        if not self.force and not own and path.exists():
            self._own(path, going_on=True)
        try:
            path.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise RigError(f"{path} cannot be created: {error.strerror}") from None
        self.in_use = True
        remove_staged_files_of_killed_commands(path)
        (path / GROWING).mkdir(exist_ok=True)
        self._growing.append((path, lock_unused_folder(path / GROWING)))
        write_text(path / MANIFEST, FolderManifest(self._origin(False), load_manifest(path).files).text())
        return path

    def _staged_folder(self, place: Path, path: Path) -> StagedFolder:
        """The StagedFolder of a folder. path : as the user named what is written there"""
        self.in_use = True
        if place not in self._staged:
            try:
                self._staged[place] = StagedFolder(place, self.command)
            except OSError as error:
                raise RigError(
                    f"{path} cannot be {'written' if place.is_dir() else 'made'}: {error.strerror}"
                ) from None
        return self._staged[place]

    def _origin(self, done: bool) -> FolderOrigin:
        return FolderOrigin(self.command, self.arguments, done, self.data)

    def _no_input(self, path: Path, what: str) -> None:
        status = path_status(path)
        for given in self.inputs:
            other = path_status(given)
            if os.path.realpath(path) == os.path.realpath(given) or (
                status and other and os.path.samestat(status, other)
            ):
                raise RigError(f"{path} is {what}; it remains unchanged, name another place to write to")

    def _own(self, path: Path, going_on: bool = False) -> None:
        """Raise RigError where a folder holds what this command did not make or somebody changed since."""
        known = load_manifest(path)
        inside = (
            sorted(entry.name for entry in path.iterdir() if not entry.name.startswith(".rig-"))
            if path.is_dir()
            else []
        )
        if known.origin is None or known.origin.command != self.command:
            if inside:
                raise FileError(
                    path,
                    f"is not empty, and `rig {self.command}` did not make what is in it ({', '.join(inside[:3])}"
                    f"{', ..' if len(inside) > 3 else ''}); name another folder, or write over it with --force",
                )
            return
        if going_on:
            return
        mine = {name: entry for name, entry in known.files.items() if entry.command == self.command}
        changed = [name for name in mine if (path / name).exists() and not known.untouched(path, name, self.command)]
        roots = {name.split("/")[0] for name in mine}
        changed += [
            name for name in inside if is_recording_table(name) and name not in roots and name not in known.files
        ]
        if changed:
            raise FileError(
                path / changed[0],
                f"was changed or added since `rig {self.command}` wrote the folder"
                f"{f', and {len(changed) - 1} more' if len(changed) > 1 else ''}; name another folder, or "
                "write over it with --force",
            )


def _here(path: Path) -> None:
    """Raise RigError for a place behind a URL: what commands make is put there whole or not at all, which only a file
    system does.
    """
    if local_and_remote_input_files.is_remote(path):
        raise RigError(
            f"{local_and_remote_input_files.remote_url(path)} is behind a URL, from which recordings are read; "
            "results are written on this computer, name a place here"
        )
