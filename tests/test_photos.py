"""Points in photos are where they are, as surely as said; what cannot be right is left out."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from command_line import done, run
from marks import quick

cv2 = pytest.importorskip("cv2")

from photographs import Pinhole, facing, photograph, save  # noqa: E402
from PIL import Image  # noqa: E402

from pincal.instruments.board import Board  # noqa: E402
from pincal.instruments.detect import PhotoPoints, checked, points_in  # noqa: E402

CHARUCO = Board("b", "charuco", (7, 6), 0.03)
DATA = Path("/usr/share/doc/opencv-doc/examples/data")
TILTS = ((0.3, -0.4, 0.2), (-0.5, 0.1, 1.2), (0.1, 0.5, 3.0), (-0.2, -0.3, -0.8))


def seen(boards: Iterable[Board], *paths: Path) -> list[PhotoPoints]:
    """Return what photos show."""
    photos = list(points_in(list(boards), paths))
    checked(photos)
    return photos


def errors(board: Board, folder: Path, count: int, **photo: float) -> tuple[np.ndarray, np.ndarray]:
    """Return errors, (n, 2), and standard deviations, (n,), of points in some photos, [px]."""
    missed, sigmas = [], []
    for number, tilt in enumerate(TILTS[:count]):
        place = facing(board, 0.42, tilt)
        grey, truth = photograph(board, place, Pinhole(), seed=number, **photo)
        (points,) = seen([board], save(folder / f"{number}.png", grey))
        assert len(points.points) > 0.8 * len(truth)
        missed += [np.array(points.points[name][:2]) - truth[name] for name in points.points]
        sigmas += [sigma for *_, sigma in points.points.values()]
    return np.array(missed), np.array(sigmas)


@pytest.mark.parametrize(
    ("kind", "blur", "noise", "count"),
    quick(
        1,
        [
            ("charuco", 0.7, 0.01, 1),
            ("charuco", 1.3, 0.02, 2),
            ("chessboard", 0.7, 0.01, 2),
            ("apriltag", 0.7, 0.02, 1),
            ("aruco", 1.0, 0.01, 1),
        ],
    ),
)
def test_standard_deviations_are_those_of_the_errors(
    kind: str, blur: float, noise: float, count: int, tmp_path: Path
) -> None:
    """On photos with known truth, predicted over observed errors are 0.8 to 1.25; no bias."""
    board = Board("b", kind, (8, 7), 0.03) if kind == "chessboard" else None
    board = board or Board("b", kind, (7, 6), 0.03)
    missed, sigmas = errors(board, tmp_path, count, blur=blur, noise=noise)
    observed = np.sqrt((missed**2).mean())
    assert 0.8 < np.sqrt((sigmas**2).mean()) / observed < 1.25
    assert np.abs(missed.mean(axis=0)).max() < 4 * observed / np.sqrt(len(missed))
    assert observed < (0.015 if kind in ("charuco", "chessboard") else 0.06)


def test_numbers_of_a_chessboard_follow_its_colours(tmp_path: Path) -> None:
    """A chessboard's points keep their names whichever way up it is seen."""
    board = Board("b", "chessboard", (8, 7), 0.03)
    for number, tilt in enumerate(TILTS[1:3]):
        grey, truth = photograph(board, facing(board, 0.45, tilt), Pinhole(), seed=number)
        (photo,) = seen([board], save(tmp_path / f"{number}.png", grey))
        assert max(np.hypot(*(np.array(p[:2]) - truth[n])) for n, p in photo.points.items()) < 0.1


@pytest.mark.slow
def test_photos_to_table(tmp_path: Path) -> None:
    """Commands print a board and find it: by row, in the order of the times of the photos.

    A blurred photo is left out and named; the turn that a file notes for viewers is not made.
    """
    done("board", "--squares", "7x6", "--square", "30mm", "-o", tmp_path / "b.pdf")
    truths, names = [], ["c.jpg", "a.jpg", "b.jpg", "d.jpg"]
    for number, name in enumerate(names):
        place = facing(CHARUCO, 0.42, TILTS[number])
        grey, truth = photograph(CHARUCO, place, Pinhole(), blur=0.7 + 2 * (number == 3))
        picture, tags = Image.fromarray((grey / 16).astype(np.uint8)), Image.Exif()
        tags[0x0112] = 6 if number == 1 else 1  # a viewer shows it turned
        tags[0x0132] = f"2026:03:01 10:00:{10 + number}"
        picture.save(tmp_path / name, exif=tags, quality=95)
        truths.append(truth)
    rows = tmp_path / "rows.csv"
    rows.write_text("x [mm]\n" + "1\n" * 4)
    photos = [tmp_path / name for name in sorted(names)]
    table = tmp_path / "corners.csv"
    outcome = done("detect", tmp_path / "b.yaml", *photos, "--rows", rows, "-o", table)
    assert "d.jpg: not used: blurred over 2." in outcome.out
    assert "90 corners in 3 of 4 photos" in outcome.out
    assert "in the order of their times" in outcome.err
    with Image.open(tmp_path / "corners.png") as sheet:
        assert sheet.size[0] > 1000
    corners = pd.read_csv(table)
    assert set(zip(corners["row"], corners["image"], strict=True)) == set(
        zip((1, 2, 3), names, strict=False)
    )
    for row, point, u, v in corners[["row", "point", "u [px]", "v [px]"]].itertuples(index=False):
        assert np.hypot(*(np.array([u, v]) - truths[row - 1][point])) < 0.1
    rows.write_text("x [mm]\n" + "1\n" * 5)
    outcome = run("detect", tmp_path / "b.yaml", *photos, "--rows", rows, "-o", tmp_path / "n.csv")
    assert outcome.code == 2
    assert "4 photos and 5 rows" in outcome.trouble
    rows.write_text("x [mm],image\n1,a.jpg\n2,b.jpg\n3,e.jpg\n")
    outcome = done("detect", tmp_path / "b.yaml", *photos, "--rows", rows, "-o", tmp_path / "n.csv")
    assert "rows without their photo: e.jpg" in outcome.err
    assert "c.jpg: not used: in no rows of rows.csv" in outcome.out
    for name in ("a", "b"):
        Image.open(tmp_path / f"{name}.jpg").save(tmp_path / f"{name}.png")  # without a time
    rows.write_text("x [mm]\n1\n1\n")
    photos = [tmp_path / "b.png", tmp_path / "a.png"]
    outcome = done("detect", tmp_path / "b.yaml", *photos, "--rows", rows, "-o", tmp_path / "m.csv")
    assert "in the order given" in outcome.err
    corners = pd.read_csv(tmp_path / "m.csv")
    assert dict(zip(corners["image"], corners["row"], strict=True)) == {"b.png": 1, "a.png": 2}
    photos[0].rename(tmp_path / "img10.png")
    photos[1].rename(tmp_path / "img9.png")
    photos = sorted(tmp_path.glob("img*.png"))  # as a shell lists them
    done("detect", tmp_path / "b.yaml", *photos, "--rows", rows, "-o", tmp_path / "k.csv")
    corners = pd.read_csv(tmp_path / "k.csv")
    assert dict(zip(corners["image"], corners["row"], strict=True)) == {
        "img9.png": 1,
        "img10.png": 2,
    }


@pytest.mark.parametrize(
    ("fault", "told"),
    quick(
        2,
        [
            ("mirrored", "markers are mirrored"),
            ("squares", "markers do not lie as on b: it is another board"),
            ("numbers", "markers 40, 41, 42, 43, …, 60 are none of b: it is another board"),
            ("dictionary", "the markers are of the dictionary 5X5_1000, b has 4X4_250"),
            ("nothing", "no marker is found"),
        ],
    ),
)
def test_photos_of_something_else_say_why(fault: str, told: str, tmp_path: Path) -> None:
    """A mirrored print, another board, one too far away: each is named as what it is."""
    other = {
        "dictionary": Board("o", "charuco", (7, 6), 0.03, dictionary="5X5_100"),
        "numbers": Board("o", "charuco", (7, 6), 0.03, first=40),
        "squares": Board("o", "charuco", (6, 7), 0.03),
    }.get(fault, CHARUCO)
    place = facing(other, 0.42, TILTS[0])
    grey, _ = photograph(other, place, Pinhole(), noise=0.002)
    grey = grey[:, ::-1] if fault == "mirrored" else grey
    grey = np.full_like(grey, 2000) if fault == "nothing" else grey
    (photo,) = seen([CHARUCO], save(tmp_path / "a.png", grey))
    assert told in photo.reason
    assert not photo.points


@pytest.mark.slow
def test_a_photo_that_a_program_turned_is_left_out(tmp_path: Path) -> None:
    """One whose sides are exchanged has another lens; it is named, and so is a copy."""
    grey, _ = photograph(CHARUCO, facing(CHARUCO, 0.42, TILTS[0]), Pinhole())
    pictures = (grey, (0.98 * grey).astype(grey.dtype), np.ascontiguousarray(grey.T[::-1]), grey)
    paths = [save(tmp_path / f"{i}.png", picture) for i, picture in enumerate(pictures)]
    photos = seen([CHARUCO], *paths)
    assert [bool(photo.points) for photo in photos] == [True, True, False, False]
    assert "480x640 pixels, the others 640x480: some program has turned it" in photos[2].reason
    assert photos[3].reason == "the same picture as 0.png"


@pytest.mark.slow
def test_two_boards_in_one_photo_share_no_marker(tmp_path: Path) -> None:
    """Boards with the same markers are refused; with others each gets its points."""
    for name, first in (("p", 0), ("q", 5), ("r", 40)):
        board = Board(name, "charuco", (7, 6), 0.03, first=first)
        (tmp_path / f"{name}.yaml").write_text(board.yaml())
    grey, _ = photograph(CHARUCO, facing(CHARUCO, 0.42, TILTS[0]), Pinhole())
    photo, out = save(tmp_path / "a.png", grey), tmp_path / "c.csv"
    outcome = run("detect", tmp_path / "p.yaml", tmp_path / "q.yaml", photo, "-o", out)
    assert outcome.code == 2
    assert "share markers (5, 6, 7, 8, …, 20)" in outcome.trouble
    outcome = run("detect", tmp_path / "p.yaml", tmp_path / "r.yaml", photo, "-o", ".")
    assert "pincal: . is a folder; name a file to write" in outcome.trouble
    done("detect", tmp_path / "p.yaml", tmp_path / "r.yaml", photo, "-o", out)
    assert set(pd.read_csv(out)["point"]) == {f"p_{i}" for i in range(30)}


CUT_OFF = cv2.imencode(".png", np.arange(6400, dtype=np.uint16).reshape(80, 80))[1].tobytes()[:-60]


@pytest.mark.parametrize("text", [b"", b"\xff\xd8\xff\xe0 no picture", b"GIF89a", CUT_OFF])
def test_what_is_no_photo_is_refused(
    text: bytes, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """Files that are no pictures are named, and nothing else is printed of them."""
    (tmp_path / "b.yaml").write_text(CHARUCO.yaml())
    (tmp_path / "a.jpg").write_bytes(text)
    outcome = run("detect", tmp_path / "b.yaml", tmp_path / "a.jpg", "-o", tmp_path / "c.csv")
    assert outcome.code == 2
    assert "a.jpg is no picture that can be read" in outcome.trouble
    assert capfd.readouterr().err == ""
    assert not (tmp_path / "c.csv").exists()


@pytest.mark.slow
@pytest.mark.skipif(not (DATA / "left01.jpg").exists(), reason="needs Debian's opencv-doc")
def test_lens_of_real_photos_is_that_of_opencv() -> None:
    """From photos of OpenCV's own examples, its calibration gets its lens within its intervals.

    From our points the fit is closer than from its own.
    """
    board = Board("b", "chessboard", (10, 7), 0.025)
    paths = sorted(DATA.glob("left[01]?.jpg"))
    places = np.array(list(board.points.values()), np.float32)
    photos, theirs = seen([board], *paths), []
    for path in paths:
        picture = cv2.imread(str(path), 0)
        _, corners = cv2.findChessboardCorners(picture, (9, 6))
        theirs.append(cv2.cornerSubPix(picture, corners, (5, 5), (-1, -1), (3, 100, 1e-6)))
    grid = np.zeros((54, 3), np.float32)
    grid[:, :2] = 0.025 * np.mgrid[0:9, 0:6].T.reshape(-1, 2)
    names = list(board.points)
    on_board = [places[[names.index(name) for name in photo.points]] for photo in photos]
    ours = [
        np.array([p[:2] for p in photo.points.values()], np.float32)[:, None] for photo in photos
    ]
    fits = [
        cv2.calibrateCameraExtended(objects, pixels, (640, 480), None, None)
        for objects, pixels in (([grid] * len(paths), theirs), (on_board, ours))
    ]
    lenses = [np.array([K[0, 0], K[1, 1], K[0, 2], K[1, 2], *k.ravel()]) for _, K, k, *_ in fits]
    sigmas = [fit[5].ravel()[:9] for fit in fits]
    assert (np.abs(lenses[1] - lenses[0]) < 2.5 * np.hypot(*sigmas)).all()
    assert fits[1][0] < fits[0][0] < 0.25
