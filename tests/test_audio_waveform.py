"""Reading speech: formats are recognised by content, and unreadable files give a one-line error."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path

import av
import numpy as np
import pytest
import soundfile
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from talkingeyes.audio.waveform import SAMPLE_RATE, frame_count, loudest_dbfs, read_speech
from talkingeyes.core.errors import InputError

REAL = Path(__file__).parents[2] / "shared" / "data" / "real" / "speech"


def tone(rate: int, seconds: float = 1.0, hz: float = 440.0) -> np.ndarray:
    return (0.3 * np.sin(2 * np.pi * hz * np.arange(round(rate * seconds)) / rate)).astype(np.float32)


@pytest.mark.parametrize(
    ("container", "coding", "rate"),
    [
        ("WAV", "PCM_16", 8_000),
        ("WAV", "FLOAT", 44_100),
        ("FLAC", "PCM_24", 96_000),
        ("OGG", "VORBIS", 22_050),
        ("OGG", "OPUS", 48_000),
        ("MP3", "MPEG_LAYER_III", 44_100),
    ],
)
@pytest.mark.parametrize("name", ["plain", "wrong.txt", "raw name.raw", "odd \N{SNOWMAN} -x.g722"])
def test_format_is_recognised_by_content(tmp_path: Path, container: str, coding: str, rate: int, name: str) -> None:
    path = tmp_path / name
    with path.open("wb") as file:
        soundfile.write(file, np.stack([tone(rate), tone(rate)], axis=1), rate, format=container, subtype=coding)
    sound = read_speech(path)
    assert sound.dtype == np.float32
    assert abs(len(sound) / SAMPLE_RATE - 1) < 0.1
    spectrum = np.abs(np.fft.rfft(sound[1600:14_400]))
    assert abs(np.argmax(spectrum) * SAMPLE_RATE / 12_800 - 440) < 2
    assert abs(np.abs(sound[4000:12_000]).max() - 0.3) < 0.02


def test_m4a_and_sound_of_a_video_are_read(tmp_path: Path) -> None:
    path = tmp_path / "speech"
    with av.open(str(path), "w", format="ipod") as container:
        stream = container.add_stream("aac", rate=44_100, layout="mono")
        frame = av.AudioFrame.from_ndarray(tone(44_100)[None], format="fltp", layout="mono")
        frame.sample_rate = 44_100
        for packet in [*stream.encode(frame), *stream.encode(None)]:
            container.mux(packet)
    assert abs(len(read_speech(path)) / SAMPLE_RATE - 1) < 0.1


OPEN, LENGTH = 0xFFFFFFFF, 64_000  # bytes of two seconds
LIST = b"LIST" + struct.pack("<I", 26) + b"INFOISFT\x0e\0\0\0Lavf58.29.100\0"


def sizes64(riff: int, data: int) -> bytes:
    return b"ds64" + struct.pack("<IQQQI", 28, riff, data, data // 2, 0)


@pytest.mark.parametrize(
    ("magic", "riff", "before", "data"),
    [
        (b"RIFF", 0, b"", 0),
        (b"RIFF", LENGTH + 36, b"", 0),
        (b"RIFF", 36, LIST, 0),
        (b"RIFF", OPEN, LIST, OPEN),
        (b"RIFF", 0x7FFFFFFF, b"", 0x7FFFFFFF - 36),
        (b"RIFF", 0, b"", LENGTH),
        (b"RIFF", LENGTH + 48, b"junk\3\0\0\0abc\0", LENGTH),
        (b"RF64", OPEN, sizes64(LENGTH + 72, LENGTH), OPEN),
        (b"RF64", OPEN, sizes64(0, 0), OPEN),
        (b"RF64", OPEN, sizes64(2**64 - 1, 2**64 - 1), OPEN),
        (b"BW64", OPEN, sizes64(LENGTH + 72, LENGTH), OPEN),
        (b"BW64", OPEN, sizes64(0, 0), OPEN),
    ],
)
def test_wav_without_its_size_is_read_to_the_end(
    tmp_path: Path, magic: bytes, riff: int, before: bytes, data: int
) -> None:
    sound = tone(16_000, seconds=2.0)
    coding = b"fmt " + struct.pack("<IHHIIHH", 16, 1, 1, 16_000, 32_000, 2, 16)
    head = magic + struct.pack("<I", riff) + b"WAVE" + before + coding + b"data" + struct.pack("<I", data)
    (tmp_path / "a.wav").write_bytes(head + (sound * 32_768).astype("<i2").tobytes())
    np.testing.assert_allclose(read_speech(tmp_path / "a.wav"), sound, atol=1e-3)


@pytest.mark.parametrize("length", [LENGTH, 0])
def test_odd_chunks_may_lack_their_pad_byte(tmp_path: Path, length: int) -> None:
    sound = tone(16_000, seconds=2.0)
    coding = b"fmt " + struct.pack("<IHHIIHH", 16, 1, 1, 16_000, 32_000, 2, 16)
    for before, after in (
        (b"JUNK\3\0\0\0abc", b"iXML\5\0\0\0hello"),
        (b"", b"iXML\5\0\0\0hello\0"),
        (b"", b"LIST\5\0\0\0INFOd"),
    ):
        head = b"RIFF" + struct.pack("<I", 0) + b"WAVE" + before + coding + after + b"data" + struct.pack("<I", length)
        (tmp_path / "a.wav").write_bytes(head + (sound * 32_768).astype("<i2").tobytes())
        np.testing.assert_allclose(read_speech(tmp_path / "a.wav"), sound, atol=1e-3)


@pytest.mark.parametrize(("left", "right"), [(1.0, -1.0), (0.7, -1.0), (-1.0, 0.9)])
@pytest.mark.parametrize("container", ["WAV", "m4a"])
def test_opposite_phase_does_not_cancel(tmp_path: Path, left: float, right: float, container: str) -> None:
    path, both = tmp_path / "a.wav", np.stack([left * tone(48_000), right * tone(48_000)])
    if container == "WAV":
        soundfile.write(path, both.T, 48_000, subtype="FLOAT")
    else:
        with av.open(str(path), "w", format="ipod") as file:
            stream = file.add_stream("alac", rate=48_000, layout="stereo")
            frame = av.AudioFrame.from_ndarray((both * 32_767).astype(np.int16), format="s16p", layout="stereo")
            frame.sample_rate = 48_000
            for packet in [*stream.encode(frame), *stream.encode(None)]:
                file.mux(packet)
    loudest = max(left, right, key=abs)
    middle = slice(1600, 14_400)
    np.testing.assert_allclose(read_speech(path)[middle], (loudest * tone(16_000))[middle], atol=2e-3)


@pytest.mark.parametrize("channels", [[1, 0], [1, 0.5], [1, -0.2], [0, 0, 1, 0, 0, 0]])
def test_other_channels_are_mixed(tmp_path: Path, channels: list[float]) -> None:
    sound = np.outer(tone(16_000), channels).astype(np.float32)
    soundfile.write(tmp_path / "a.wav", sound, 16_000, subtype="FLOAT")
    np.testing.assert_allclose(read_speech(tmp_path / "a.wav"), sound.mean(axis=1), atol=1e-6)


def _write(samples: np.ndarray, rate: int = 16_000) -> Callable[[Path], object]:
    return lambda path: soundfile.write(path, samples, rate, format="WAV", subtype="FLOAT")


def _with(value: float) -> np.ndarray:
    samples = tone(16_000)
    samples[100] = value
    return samples


def _playlist(path: Path) -> object:
    other = path.with_name("other.wav")
    _write(tone(16_000))(other)
    return path.write_text(f"#EXTM3U\n#EXT-X-TARGETDURATION:1\n#EXTINF:1,\nfile://{other}\n#EXT-X-ENDLIST\n")


def _damaged(path: Path) -> object:
    soundfile.write(path, np.random.default_rng(0).standard_normal(400_000) * 0.1, 16_000, format="FLAC")
    content = path.read_bytes()
    return path.write_bytes(content[: len(content) // 2])


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda path: None, "No such file"),
        (lambda path: path.mkdir(), "is a folder"),
        (lambda path: path.touch(), "empty"),
        (lambda path: path.write_text("Good morning.\n" * 100), "decoded"),
        (lambda path: path.write_bytes(np.random.default_rng(0).bytes(50_000)), "decoded"),
        (_playlist, "decoded"),
        (_damaged, "damaged"),
        (_write(_with(np.nan)), "NaN"),
        (_write(_with(np.inf)), "NaN"),
        (_write(np.zeros(16_000)), "silent"),
        (_write(np.full(48_000, 0.4), 48_000), "silent"),
        (_write(tone(16_000) * 1e-4), "silent"),
        (_write(tone(16_000)[:0]), "at least 0.3 s"),
        (_write(tone(16_000)[:4700]), "at least 0.3 s"),
        (_write(np.zeros(3601 * 100, np.float32), 100), "at most 3600 s"),
    ],
)
def test_unreadable_file_is_one_line_error_with_path(
    tmp_path: Path, make: Callable[[Path], object], words: str
) -> None:
    path = tmp_path / "speech.wav"
    make(path)
    with pytest.raises(InputError, match=words) as caught:
        read_speech(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    content=st.binary(min_size=1, max_size=3000),
    start=st.sampled_from([b"", b"RIFF", b"RF64", b"fLaC", b"OggS", b"ID3\3"]),
)
def test_arbitrary_content_raises_only_input_errors(tmp_path: Path, content: bytes, start: bytes) -> None:
    path = tmp_path / "any"
    path.write_bytes(start + content)
    try:
        assert len(read_speech(path)) >= 4800
    except InputError as error:
        assert "\n" not in str(error)


@given(frames=st.integers(0, 90_000), fps=st.sampled_from([24.0, 25.0, 30.0, 50.0, 60.0, 100.0]))
def test_whole_frames_count_exactly(frames: int, fps: float) -> None:
    samples = -(-frames * SAMPLE_RATE // int(fps))
    assert frame_count(samples, fps) == frames
    assert frame_count(samples, fps) == samples * int(fps) // SAMPLE_RATE


@pytest.mark.skipif(not REAL.is_dir(), reason="needs the real recordings")
def test_real_recordings_are_read() -> None:
    for path in sorted(REAL.iterdir()):
        sound = read_speech(path)
        assert 1 < len(sound) / SAMPLE_RATE < 80
        assert loudest_dbfs(sound) > -30
