"""Takes: LiveLink Face's CSV and JSON, by name and with their times, and resampling."""

import codecs
import json
import re

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from softdeca.lhm import expressions
from softdeca.lhm.expressions import ARKIT, Take, index, read_take, resample, rotations

NAMES = [name[0].upper() + name[1:] for name in ARKIT]
HEADER = ["Timecode", "BlendShapeCount", *NAMES, "LeftEyeYaw"]


def timecodes(frames, *, rate=60, step=1, start=0):
    at = [start + step * frame for frame in range(frames)]
    return [f"10:00:{n // rate:02d}:{n % rate:02d}.250" for n in at]


def csv_text(values, codes, header=HEADER):
    lines = [",".join(header)]
    lines += [",".join([code, "61", *map(str, row), "-0.3"]) for code, row in zip(codes, values, strict=True)]
    return "\n".join(lines) + "\n"


@pytest.fixture
def write(tmp_path):
    def to(text, name="take.csv"):
        path = tmp_path / name
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return path

    return to


def ramp(frames):
    return np.linspace(0, 1, frames)[:, None] * np.linspace(0.1, 0.9, 52)


def test_real_take_is_mapped_by_name(data):
    path = data / "arkit_sequences" / "alex_rom_3.csv"
    take = read_take(path)
    assert take.weights.shape == (4030, 52) and take.missing == () and take.clipped == 1
    assert take.rate == 30.0
    assert take.times[-1] - take.times[0] == pytest.approx(
        134.38, abs=0.01
    )  # timecodes 13:13:04:31.652 .. 13:15:18:54.561
    lines = path.read_text().splitlines()
    header, row = lines[0].split(","), lines[1000].split(",")
    for name in ("JawLeft", "JawRight", "MouthLeft", "MouthRight", "EyeBlinkLeft", "TongueOut"):
        assert take.weights[999, index(name[0].lower() + name[1:])] == float(row[header.index(name)])
    assert (take.weights.max(axis=0) > 0.05).all()
    assert np.sum(np.diff(take.times) > 1.5 / 30) == 3  # three frames were dropped


def test_columns_are_found_in_any_order_and_case(write):
    values = ramp(5)
    shuffled = np.random.default_rng(0).permutation(52)
    header = ["timecode", "BlendShapeCount", *[NAMES[k].upper() for k in shuffled], "Extra"]
    take = read_take(write(csv_text(values[:, shuffled], timecodes(5), header)))
    np.testing.assert_array_equal(take.weights, values)


@pytest.mark.parametrize(
    "spell",
    [
        lambda name: re.sub("(Left|Right)$", lambda side: f"_{side[0][0]}", name),
        lambda name: re.sub("(?=[A-Z])", "_", name).lower(),
        lambda name: f"blendShape1.{name}",
        lambda name: f"A25_{name}",
        str.upper,
    ],
)
@pytest.mark.parametrize("form", ["livelink", "recorder", "beat", "audio2face", "mediapipe"])
def test_names_are_known_to_all_readers_however_they_are_written(write, form, spell):
    """One table of spellings, `arkit_name`, behind every format."""
    values, names = ramp(3), [spell(name) for name in ARKIT]
    if form == "livelink":
        file = write(csv_text(values, timecodes(3), [*HEADER[:2], *names, "LeftEyeYaw"]))
    elif form == "recorder":
        rows = [",0,1,2", *(",".join([name, *map(str, row)]) for name, row in zip(names, values.T, strict=True))]
        file = write("\n".join(rows))
    elif form == "beat":
        frames = [{"weights": row.tolist(), "time": k / 30} for k, row in enumerate(values)]
        file = write(json.dumps({"names": names, "frames": frames}), "take.json")
    elif form == "audio2face":
        export = {"exportFps": 25, "numPoses": 52, "numFrames": 3, "facsNames": names, "weightMat": values.tolist()}
        file = write(json.dumps(export), "take.json")
    else:
        scores = [dict(zip(names, row.tolist(), strict=True)) for row in values]
        file = write(json.dumps(landmarker(*scores)), "take.json")
    take = read_take(file)
    np.testing.assert_array_equal(take.weights, values)
    assert take.missing == () and (form != "audio2face" or (take.rate == 25 and take.times[2] == 2 / 25))


@pytest.mark.parametrize(
    "save",
    [
        lambda text: text.replace(",", ";"),
        lambda text: text.replace(",", "\t"),
        lambda text: "\ufeffsep=;\n" + text.replace(",", ";").replace(".", ","),
        lambda text: text.replace(",", "\t").replace(".", ",").encode("utf-16"),
        lambda text: codecs.BOM_UTF16_BE + text.encode("utf-16-be"),
        lambda text: text.encode("utf-16-le"),
    ],
)
def test_tables_may_come_from_excel_or_windows(write, save):
    """With semicolons, tabs, decimal commas, or as UTF-16; a line and a row per quantity alike."""
    values = ramp(90)
    np.testing.assert_array_equal(read_take(write(save(csv_text(values, timecodes(90))))).weights, values)
    stamps, still = np.arange(90) / 60, np.tile([0.0, 0.0, 0.0, 1.0], (90, 1))
    take = read_take(write(save(recorder_csv(values, stamps, still))))
    np.testing.assert_array_equal(take.weights, values)
    np.testing.assert_allclose(take.times, stamps, atol=1e-5)


def test_missing_columns_are_zero_and_named(write):
    kept = [k for k in range(52) if ARKIT[k] not in ("tongueOut", "jawLeft")]
    header = ["Timecode", "BlendShapeCount", *[NAMES[k] for k in kept], "LeftEyeYaw"]
    take = read_take(write("\ufeff" + csv_text(ramp(4)[:, kept], timecodes(4), header)))
    assert take.missing == ("jawLeft", "tongueOut")
    assert not take.weights[:, [index("jawLeft"), index("tongueOut")]].any()
    np.testing.assert_array_equal(take.weights[:, kept], ramp(4)[:, kept])


def test_values_are_clipped_and_counted(write):
    values = ramp(4)
    values[1, 3], values[2, 7], values[3, 0] = 1.05, -0.01, 1.0
    take = read_take(write(csv_text(values, timecodes(4))))
    assert take.clipped == 2
    assert take.weights[1, 3] == 1.0 and take.weights[2, 7] == 0.0


@pytest.mark.parametrize(
    ("rate", "step", "expected"), [(60, 1, 60), (60, 2, 30), (30, 1, 30), (24, 1, 24), (25, 1, 25)]
)
def test_rate_is_that_of_the_timecodes(write, rate, step, expected):
    take = read_take(write(csv_text(ramp(150), timecodes(150, rate=rate, step=step))))
    assert take.rate == pytest.approx(expected)
    np.testing.assert_allclose(take.times, np.arange(150) / expected, atol=1e-12)


def video_codes(fps, seconds):
    """Labels that converters of videos write: whole frames since the second, at the video's rate."""
    return [
        f"00:{int(n / fps) // 60:02d}:{int(n / fps) % 60:02d}:{int(n % fps):02d}" for n in range(int(fps * seconds))
    ]


@pytest.mark.parametrize("fps", [10, 12, 15, 22, 23, 27, 28, 29, 29.83, 45, 47, 56, 58, 59, 59.94, 72, 75, 90, 119.88])
def test_a_video_may_have_any_rate(write, fps):
    codes = video_codes(fps, 40)
    take = read_take(write(csv_text(ramp(len(codes)), codes)))
    assert take.rate == pytest.approx(fps, abs=0.03)
    np.testing.assert_allclose(take.times, np.arange(len(codes)) / fps, atol=0.6 / fps)
    np.testing.assert_allclose(np.diff(take.times), 1 / take.rate, atol=1e-9)
    assert not len(resample(take, 30.0).gaps)


@pytest.mark.parametrize(("labels", "dropped"), [(30, 2), (60, 4)])
@pytest.mark.parametrize("step", [1, 2])
@pytest.mark.parametrize("mark", [";", ":"])
def test_drop_frame_labels_are_of_29_97_and_59_94_hertz(write, labels, dropped, mark, step):
    """SMPTE ST 12-1: no label is of frame 0 or 1 (0 to 3) of a minute, but for each tenth."""
    every = [(s, f) for s in range(535, 660) for f in range(labels) if s % 60 or not s % 600 or f >= dropped][::step]
    codes = [f"00:{s // 60:02d}:{s % 60:02d}{mark}{f:02d}" for s, f in every]
    take = read_take(write(csv_text(ramp(len(codes)), codes)))
    assert take.rate == pytest.approx(labels / 1.001 / step, rel=1e-12)
    np.testing.assert_allclose(take.times, np.arange(len(codes)) / take.rate, atol=1e-9)


@pytest.mark.parametrize("rate", [24, 25, 30, 50, 60])
def test_a_short_take_over_the_end_of_a_second_has_that_rate(write, rate):
    take = read_take(write(csv_text(ramp(6), timecodes(6, rate=rate, start=rate - 3))))
    assert take.rate == rate
    np.testing.assert_allclose(take.times, np.arange(6) / rate, atol=1e-12)


def test_times_go_on_over_midnight_and_over_lines_without_a_face(write):
    codes = ["23:59:59:57.000", "23:59:59:58.000", "23:59:59:59.000", "00:00:00:00.000", "00:00:00:01.000"]
    lines = csv_text(ramp(5), codes).splitlines()
    lines[2] = "23:59:59:58.000,0" + "," * 53
    take = read_take(write("\n".join(lines)))
    np.testing.assert_allclose(take.times, [0, 2 / 60, 3 / 60, 4 / 60], atol=1e-9)
    np.testing.assert_array_equal(take.weights, ramp(5)[[0, 2, 3, 4]])


def test_lines_without_a_face_are_left_out_and_counted(write):
    """As the app writes them: the timecode and a 0. Nothing moves in time; where they were, a gap stands."""
    lines = csv_text(ramp(12), timecodes(12)).splitlines()
    for frame in (0, 4, 5, 6, 7, 8, 9, 11):
        lines[1 + frame] = lines[1 + frame].split(",")[0] + (",0" if frame % 2 else ",0.0")
    take = read_take(write("\n".join(lines)))
    kept = np.array([1, 2, 3, 10])
    assert take.lost == 8 and take.rate == 60
    np.testing.assert_allclose(take.times, (kept - 1) / 60, atol=1e-9)
    np.testing.assert_array_equal(take.weights, ramp(12)[kept])
    even = resample(take, 60.0)
    np.testing.assert_allclose(even.weights, ramp(12)[1:11], atol=1e-9)
    np.testing.assert_allclose(even.gaps, [[2 / 60, 9 / 60]], atol=1e-9)
    assert even.remarks() == ("8 frames without a face left out; the weights between are read off a line",)
    assert even.part(slice(0, 2)).lost == 0 and even.part(slice(0, 2)).remarks() == ()
    np.testing.assert_array_equal(read_take(write("\r".join(lines))).weights, take.weights)


def test_a_real_take_with_lost_faces_is_read(data):
    path = data / "arkit_sequences" / "s88_001_lost_face_rows.csv"
    take = read_take(path)
    assert take.weights.shape == (1662, 52) and take.lost == 277 and take.rate == 30.0
    rows = path.read_text().splitlines()
    header, last = rows[0].split(","), [row for row in rows if not row.endswith(",0")][-1].split(",")
    assert take.weights[-1, index("jawOpen")] == float(last[header.index("JawOpen")])
    minutes = lambda code: float(code.split(":")[1]) * 60 + float(code.split(":")[2]) + float(code.split(":")[3]) / 60  # noqa: E731
    assert take.times[-1] - take.times[0] == pytest.approx(minutes(last[0]) - minutes(rows[1].split(",")[0]), abs=1e-6)


def test_only_what_is_used_is_counted(write):
    values = ramp(120)
    values[10, 3], values[100, 3:5] = 1.05, -0.01
    take = resample(read_take(write(csv_text(values, timecodes(120)))), 60.0)
    assert take.clipped == 3
    assert take.part(slice(0, 60)).clipped == 1 and take.part(slice(20, 60)).clipped == 0
    assert take.part(slice(20, 60)).remarks() == ()
    assert take.part(slice(60, 120)).remarks() == ("2 weights outside [0, 1] clipped",)


def test_the_head_is_kept_where_it_was_tracked(write):
    """Yaw of the file turns to the subject's right, ours to the left; a resampled take has it too."""
    header = [*HEADER[:-1], "HeadYaw", "HeadPitch", "HeadRoll"]
    angles = np.linspace(-0.4, 0.4, 30)[:, None] * [1.0, 0.5, -0.25]
    lines = [",".join(header)]
    for code, row, angle in zip(timecodes(30), ramp(30), angles, strict=True):
        lines.append(",".join([code, "61", *map(str, row), *map(repr, angle.tolist())]))
    take = read_take(write("\n".join(lines)))
    np.testing.assert_allclose(take.head, angles * [-1, 1, -1], atol=1e-15)
    twice = resample(take, 120.0)
    np.testing.assert_allclose(twice.head[::2], take.head, atol=1e-9)
    assert take.part(slice(3, 5)).head.shape == (2, 3)
    still = [line.rsplit(",", 3)[0] + ",0,0,0.0" for line in lines[1:]]
    assert read_take(write("\n".join([lines[0], *still]))).head is None
    assert read_take(write(csv_text(ramp(3), timecodes(3)))).head is None


def recorder_csv(values, stamps, quaternions):
    """As an app of this kind writes it: frames' numbers, two more than there are frames, then a row a quantity."""
    order = np.random.default_rng(1).permutation(52)
    rows = ["," + ",".join(map(str, range(len(values) + 2)))]
    rows.append("timestamp," + ",".join(f"{s:.5f}" for s in stamps))
    rows += [NAMES[k] + "," + ",".join(map(repr, values[:, k].tolist())) for k in order]
    for axis, column in zip("xyzw", quaternions.T, strict=True):
        rows.append(f"head {axis}," + ",".join(map(repr, column.tolist())))
    rows += [f"{name}," + ",".join(["0.5"] * len(values)) for name in ("left x", "right w", "lookAtPoint z")]
    return "\n".join(rows) + "\n"


def test_a_row_per_quantity_is_read_too(write):
    values, angles = ramp(90), np.linspace(-0.6, 0.6, 90)[:, None] * [1.0, 0.7, -0.4]
    values[7, 0] = 1.2
    turned = Rotation.from_euler("YXZ", angles)
    stamps = 3.0 + np.arange(90) / 60
    take = read_take(write(recorder_csv(values, stamps, turned.as_quat()), "weights.csv"))
    assert take.rate == 60.0 and take.clipped == 1 and take.missing == ()
    np.testing.assert_array_equal(take.weights, np.clip(values, 0, 1))
    np.testing.assert_allclose(take.times, np.arange(90) / 60, atol=1e-5)
    np.testing.assert_allclose(take.head, angles, atol=1e-12)
    np.testing.assert_allclose(rotations(take.head), turned.as_matrix(), atol=1e-12)


def test_json_is_read_with_its_times(write):
    rows = [[0.2, 0], [0.4, 0.1], [0, 0.0]]
    frames = [{"weights": row, "time": 2.0 + n / 30, "rotation": []} for n, row in enumerate(rows)]
    take = read_take(write(json.dumps({"names": ["JawOpen", "mouthFunnel"], "frames": frames}), "take.json"))
    expected = [{"jawOpen": 0.2}, {"jawOpen": 0.4, "mouthFunnel": 0.1}, {}]
    np.testing.assert_array_equal(take.weights, [expressions.weights_of(frame) for frame in expected])
    np.testing.assert_allclose(take.times, np.arange(3) / 30, atol=1e-12)
    assert take.rate == pytest.approx(30) and len(take.missing) == 50 and "jawOpen" not in take.missing


def landmarker(*frames, camel=False, **more):
    """Results of MediaPipe's face landmarker for frames of scores by name, None for no face."""
    name, found = ("categoryName", "faceBlendshapes") if camel else ("category_name", "face_blendshapes")
    results = []
    for number, scores in enumerate(frames):
        named = {"_neutral": 1e-6} | (scores or {})
        face = [{"index": k, "score": score, name: each} for k, (each, score) in enumerate(named.items())]
        faces = [{"categories": face, "headIndex": -1, "headName": ""} if camel else face]
        results.append({found: [] if scores is None else faces} | {key: at[number] for key, at in more.items()})
    return results


SCORES = ({"jawOpen": 0.2, "eyeBlinkLeft": 0.0}, None, {"jawOpen": 0.4, "eyeBlinkLeft": 1.25})


@pytest.mark.parametrize("camel", [False, True])
@pytest.mark.parametrize(
    ("kind", "name"),
    [
        (json.dumps, "take.json"),
        (lambda results: json.dumps({"frames": results}, indent=1), "take.json"),
        (lambda results: "\n".join(map(json.dumps, results)) + "\n", "take.json"),
        (lambda results: "\n".join(map(json.dumps, results)) + "\n", "take.jsonl"),
    ],
)
def test_results_of_mediapipe_are_read_in_all_their_forms(write, kind, name, camel):
    stamps = {"timestampMs" if camel else "timestamp_ms": [5000, 5040, 5080]}
    take = read_take(write(kind(landmarker(*SCORES, camel=camel, **stamps)), name))
    expected = [{"jawOpen": 0.2}, {"jawOpen": 0.4, "eyeBlinkLeft": 1.0}]
    np.testing.assert_array_equal(take.weights, [expressions.weights_of(frame) for frame in expected])
    np.testing.assert_allclose(take.times, [0.0, 0.08], atol=1e-12)
    np.testing.assert_allclose(take.lost_at, [0.04])
    assert take.rate == pytest.approx(25.0) and take.clipped == 1
    assert "tongueOut" in take.missing and "jawOpen" not in take.missing


def test_results_without_timestamps_are_a_webcams(write):
    take = read_take(write(json.dumps(landmarker({"jawOpen": 1.0}, {"jawOpen": 0.0})), "take.json"))
    assert take.rate == 30.0 and take.times[1] == pytest.approx(1 / 30)
    alone = read_take(write(json.dumps(landmarker({"jawOpen": 1.0})[0]), "take.json"))
    assert len(alone.weights) == 1 and alone.weights[0, index("jawOpen")] == 1.0


def sine(frequency, rate=60.0, seconds=4.0):
    times = np.arange(round(seconds * rate) + 1) / rate
    return Take(np.repeat(0.5 + 0.5 * np.sin(2 * np.pi * frequency * times)[:, None], 52, axis=1), rate, times)


def test_rising_rate_interpolates_linearly():
    take = Take(ramp(31), 30.0, np.arange(31) / 30)
    finer = resample(take, 120.0)
    assert finer.weights.shape == (121, 52) and finer.times[-1] == pytest.approx(1.0)
    np.testing.assert_allclose(finer.weights, ramp(121), atol=1e-12)
    np.testing.assert_allclose(resample(finer, 120.0).weights, finer.weights, atol=1e-12)


def test_falling_rate_averages():
    """A box of width 1/r passes a sine of frequency f by sin(pi f/r)/(pi f/r): here f = 14 Hz, r = 15 Hz: 0.071.

    Read off without the box, the 14 Hz would come back as 1 Hz at full amplitude. Linear interpolation between frames
    at 60 Hz keeps (sin(pi f/60)/(pi f/60))² = 0.83 of it before.
    """
    coarse = resample(sine(14.0), 15.0)
    inner = coarse.weights[1:-1, 0]
    expected = 0.071 * 0.83 * 0.5
    assert np.abs(inner - 0.5).max() == pytest.approx(expected, rel=0.1)
    slow = resample(sine(0.5), 15.0)
    np.testing.assert_allclose(slow.weights[1:-1, 0], 0.5 + 0.5 * np.sin(np.pi * slow.times[1:-1]), atol=2e-3)


def test_a_gap_is_bridged_in_time():
    times = np.delete(np.arange(31) / 30, [10, 11, 12])
    take = Take(np.repeat(times[:, None], 52, axis=1), 30.0, times)
    even = resample(take, 30.0)
    np.testing.assert_allclose(even.weights[:, 0], np.arange(31) / 30, atol=1e-12)
    one = Take(np.full((1, 52), 0.3), 60.0, [0.0])
    np.testing.assert_array_equal(resample(one, 30.0).weights, one.weights)
