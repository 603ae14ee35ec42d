"""Recordings behind a URL: read as those in a folder are, image by image when it is needed; what goes wrong there is
said in a line.
"""

import sys

import fsspec
import numpy as np
import pytest

from rig.cli.command_line import main
from rig.errors import FileError, MissingLibrary
from rig.formats import local_and_remote_input_files
from rig.formats.local_and_remote_input_files import read_text
from rig.recording import exposures_and_image_files
from rig.recording import recording_folder as recording
from tests.conftest import BENCH


@pytest.fixture
def upload():
    """A function that keeps a folder in memory; what is there is forgotten at the end."""
    memory = fsspec.filesystem("memory")
    local_and_remote_input_files.clear_listing_cache()

    def put(folder, place="/bucket/rec"):
        for path in folder.rglob("*"):
            if path.is_file():
                memory.pipe(f"{place}/{path.relative_to(folder)}", path.read_bytes())
        return f"memory:/{place}"

    yield put
    memory.store.clear()
    memory.pseudo_dirs[:] = [""]
    local_and_remote_input_files.clear_listing_cache()


def test_a_recording_behind_a_url_is_the_one_in_the_folder(upload, recording_folder, tmp_path, capsys):
    here, remote = recording.load_recording(recording_folder), recording.load_recording(upload(recording_folder))
    assert (
        remote.name == "rec"
        and np.array_equal(here.corners.uv, remote.corners.uv)
        and np.array_equal(here.commands.values, remote.commands.values)
    )
    for at, place in ((str(recording_folder), "here"), ("memory://bucket/rec", "there")):
        assert main(["measure", at, "--out", str(tmp_path / place), "--quiet"]) == 0
    for name in ("poses.csv", "corners.csv", "rig.toml", "commands.csv", "frames.csv"):
        assert (tmp_path / "here" / name).read_bytes() == (tmp_path / "there" / name).read_bytes()
    assert capsys.readouterr().out == ""


def test_images_are_fetched_one_by_one_when_they_are_read(upload, monkeypatch):
    address, fetched = upload(BENCH / "check"), []
    monkeypatch.setattr(
        local_and_remote_input_files,
        "read_remote_bytes",
        lambda path, most=None, real=local_and_remote_input_files.read_remote_bytes: (
            fetched.append(path.name) or real(path, most)
        ),
    )
    found = recording.load_recording(address)
    assert found.has_images and not [name for name in fetched if name.endswith(".png")]
    image = exposures_and_image_files.read_grey_or_colour_image(found.folder / found.exposures.image[4])
    assert np.array_equal(
        image, exposures_and_image_files.read_grey_or_colour_image(BENCH / "check" / found.exposures.image[4])
    )
    assert [name for name in fetched if name.endswith(".png")] == [found.exposures.image[4].rsplit("/", 1)[1]]


def test_images_that_are_missing_empty_or_cut_off_are_named(upload, capsys, tmp_path):
    memory, address = fsspec.filesystem("memory"), upload(BENCH / "check")
    names = recording.load_recording(address).exposures.image
    memory.rm(f"/bucket/rec/{names[0]}")
    memory.pipe(f"/bucket/rec/{names[1]}", b"")
    whole = memory.cat_file(f"/bucket/rec/{names[2]}")
    memory.pipe(f"/bucket/rec/{names[2]}", whole[:-100])
    with pytest.raises(FileError, match="no such image") as raised:
        recording.load_recording(address)
    assert raised.value.path == f"memory://bucket/rec/{names[0]}" and "is an empty file" in str(raised.value)
    assert "cut off" not in str(raised.value)  # which is seen when it is fetched
    with pytest.raises(FileError, match="is cut off"):
        exposures_and_image_files.read_grey_or_colour_image(recording.Path(f"{address}/{names[2]}"))
    left = recording.load_recording(address, skip_unreadable=True)
    assert [image.problem.split(" ")[:2] for image in left.skipped] == [["no", "such"], ["is", "an"], ["is", "cut"]]


def test_stages_of_a_chain_are_looked_for_there_too(upload, recording_folder):
    (recording_folder / "poses_stage1.csv").write_text("frame,x,y,z,rx,ry,rz\n0,0,0,0,0,0,0\n")
    for folder in (recording_folder, upload(recording_folder)):
        with pytest.raises(FileError, match="rec/poses_stage1.csv: rig.toml has no 'stage 1' below a last platform"):
            recording.load_recording(folder)


@pytest.mark.parametrize(
    "name, says",
    [
        ("memory://bucket/rek", "memory://bucket/rek: no such folder"),
        ("memory://none/rec", "memory://none/rec: no such folder"),
        ("memry://bucket/rec", "did you mean memory://?"),
        ("memory://bucket/rec/rig.toml", "is a file, not a recording folder"),
        ("nothing://bucket/rec", "Protocol not known: nothing"),
    ],
)
def test_what_is_not_there_is_said(upload, recording_folder, tmp_path, capsys, name, says):
    upload(recording_folder)
    assert main(["measure", name, "--out", str(tmp_path / "o")]) == 1
    error = capsys.readouterr().err
    assert says in error and "Traceback" not in error and not (tmp_path / "o").exists()


def test_a_place_that_refuses_is_said(upload, recording_folder, monkeypatch):
    address = upload(recording_folder)

    def refuse(*_, **__):
        raise RuntimeError("no credentials")

    monkeypatch.setattr(type(fsspec.filesystem("memory")), "cat_file", refuse)
    with pytest.raises(FileError, match="rig.toml: cannot be read: no credentials"):
        read_text(recording.Path(address) / "rig.toml")
    monkeypatch.setattr(type(fsspec.filesystem("memory")), "ls", refuse)
    local_and_remote_input_files.clear_listing_cache()
    with pytest.raises(FileError, match="bucket/rec: cannot be read: no credentials"):
        recording.load_recording(address)


def test_what_is_not_installed_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "gcsfs", None)
    with pytest.raises(MissingLibrary, match=r"gs://bucket/rec requires one more package: .*gcsfs"):
        recording.load_recording("gs://bucket/rec")
    monkeypatch.setitem(sys.modules, "fsspec", None)
    with pytest.raises(MissingLibrary, match=r"pip install 'rig\[remote\]'"):
        recording.load_recording("memory://bucket/other")


def test_names_leave_no_folder_behind_a_url_and_results_stay_here(upload, recording_folder, tmp_path, capsys):
    text = (recording_folder / "frames.csv").read_text().splitlines()
    cells = text[1].split(",")
    (recording_folder / "frames.csv").write_text(
        "\n".join([text[0], ",".join([*cells[:3], "../other/0.png"]), *text[2:]]) + "\n"
    )
    with pytest.raises(FileError, match="lies outside the recording"):
        recording.load_recording(upload(recording_folder))
    assert main(["design", "--radius", "0.3", "--out", "memory://bucket/rig.toml"]) == 1
    assert "results are written on this computer" in capsys.readouterr().err
    assert main(["measure", str(BENCH / "check"), "--out", "s3://bucket/measured"]) == 1
    assert "s3://bucket/measured is behind a URL" in capsys.readouterr().err and not recording.Path("s3:").exists()


def test_a_folder_here_comes_before_a_url(tmp_path, recording_folder, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "memory:").mkdir()
    recording_folder.rename(tmp_path / "memory:" / "rec")
    assert len(recording.load_recording("memory:/rec").exposures.frame) and not local_and_remote_input_files.is_remote(
        recording.Path("memory:/rec")
    )


def test_what_is_fetched_can_be_kept(upload, recording_folder, tmp_path):
    fsspec.config.conf["filecache"] = {"cache_storage": str(tmp_path / "kept")}
    try:
        address = upload(recording_folder).replace("memory://", "filecache::memory://")
        found = recording.load_recording(address)
    finally:
        fsspec.config.conf.pop("filecache")
    assert len(found.corners.uv) and len(list((tmp_path / "kept").iterdir())) >= 4


@pytest.mark.slow
def test_a_bucket_of_a_local_s3(tmp_path, monkeypatch, capsys):
    import boto3
    from moto.server import ThreadedMotoServer

    server = ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    server.start()
    try:
        host, port = server.get_host_and_port()
        for name, value in (
            ("AWS_ACCESS_KEY_ID", "a"),
            ("AWS_SECRET_ACCESS_KEY", "b"),
            ("AWS_DEFAULT_REGION", "us-east-1"),
            ("AWS_ENDPOINT_URL", f"http://{host}:{port}"),
        ):
            monkeypatch.setenv(name, value)
        bucket = boto3.client("s3")
        bucket.create_bucket(Bucket="rigs")
        for path in (BENCH / "check").rglob("*"):
            if path.is_file():
                bucket.upload_file(str(path), "rigs", f"monday/{path.relative_to(BENCH / 'check')}")
        assert main(["measure", "s3://rigs/monday", "--out", str(tmp_path / "there"), "--quiet", "--workers", "2"]) == 0
        assert main(["measure", str(BENCH / "check"), "--out", str(tmp_path / "here"), "--quiet"]) == 0
        for name in ("poses.csv", "corners.csv", "rig.toml"):
            assert (tmp_path / "here" / name).read_bytes() == (tmp_path / "there" / name).read_bytes()
        for name, says in (("s3://rigs/mondy", "no such folder"), ("s3://no-rigs/monday", "no such folder")):
            assert main(["measure", name, "--out", str(tmp_path / "o")]) == 1
            assert f"{name}: {says}" in capsys.readouterr().err
    finally:
        server.stop()
