"""Damaged datasets are found out."""

from __future__ import annotations

import json

import numpy as np
import pytest

pytest.importorskip("lerobot")

import pyarrow.parquet as pq

from regrasp_datasets.features import DONE, SEED, STATE
from regrasp_datasets.records import EPISODES_FILE
from regrasp_datasets.verify import InvalidDatasetError, problems, require_valid

pytestmark = pytest.mark.lerobot


def test_verify_counts_frames_in_the_videos(copied):
    import av

    assert problems(copied) == []
    path = next((copied / "videos/observation.images.front").rglob("*.mp4"))
    with av.open(str(path)) as source, av.open(str(path.with_name("short.mp4")), "w") as target:
        stream = target.add_stream("libsvtav1", rate=20)
        stream.width, stream.height, stream.pix_fmt = 64, 64, "yuv420p"
        frames = list(source.decode(video=0))
        for frame in frames[:-2]:
            target.mux(stream.encode(frame))
        target.mux(stream.encode(None))
    path.with_name("short.mp4").replace(path)
    with pytest.raises(InvalidDatasetError, match=r"file-000.mp4 has 46 frames, its episodes have 48"):
        require_valid(copied)


@pytest.mark.parametrize(
    ("column", "row", "value", "words"),
    [
        (STATE, 3, np.nan, "not finite in frame 3"),
        (SEED, 3, 99, "other seeds than 2"),
        (DONE, 3, True, "not true on the last frame only"),
        ("timestamp", 3, 0.9, "time stamps"),
    ],
)
def test_verify_names_what_is_wrong(copied, column, row, value, words):
    path = next((copied / "data").rglob("*.parquet"))
    table = pq.read_table(path).to_pandas()
    if column == STATE:
        table.at[row, column] = np.full_like(table.at[row, column], value)
    else:
        table.at[row, column] = value
    table.to_parquet(path)
    (problem,) = problems(copied)
    assert problem.startswith("episode 0:")
    assert words in problem


def test_verify_finds_repeated_seeds(copied):
    lines = (copied / EPISODES_FILE).read_text().splitlines()
    lines[1] = json.dumps(json.loads(lines[1]) | {"seed": 2})
    (copied / EPISODES_FILE).write_text("\n".join(lines))
    assert any("[2]" in problem for problem in problems(copied))
