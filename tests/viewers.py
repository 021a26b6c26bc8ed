#!/usr/bin/env python3
"""Reads an MCAP file of `tactile` as others do: viewers.py FILE.mcap [FOLDER]

Decodes every message with mcap-ros2-support and checks what viewers rely on: frames that are known when
they are needed, whole triangles with a colour for each corner, clouds as long as they say. Then opens the
file in Rerun without a screen and looks at three moments: nothing may be refused, and the surface must grow.
With a FOLDER the three pictures are kept there.

Needs `pip install mcap-ros2-support rerun-sdk==0.41.0 pillow` and, for Rerun on Debian without a graphics
card, `apt-get install mesa-vulkan-drivers`. Without them it says so and succeeds.
"""

import io
import os
import socket
import sys
import tempfile
import time
from collections import defaultdict
from pathlib import Path

LINE_LIST, TRIANGLE_LIST = 5, 11
UINT32, FLOAT32 = 6, 7


def needs(what):
    print(f"skipped: needs {what}")
    sys.exit(0)


def check_cloud(topic, cloud):
    fields = {f.name: f for f in cloud.fields}
    assert cloud.height == 1 and not cloud.is_bigendian, topic
    assert cloud.row_step == cloud.width * cloud.point_step == len(cloud.data), topic
    assert all(f.count == 1 and f.offset + 4 <= cloud.point_step for f in cloud.fields), topic
    assert all(fields[axis].datatype == FLOAT32 for axis in "xyz"), topic
    # Foxglove and RViz take 0xAARRGGBB from a field of this name.
    assert fields["rgba"].datatype == UINT32, topic


def check_marker(topic, marker):
    corners = {LINE_LIST: 2, TRIANGLE_LIST: 3}[marker.type]
    assert len(marker.points) > 0 and len(marker.points) % corners == 0, topic
    assert len(marker.colors) == len(marker.points), topic
    assert all(0 <= c.a <= 1 for c in marker.colors) and marker.scale.x > 0, topic
    # It stays until it is replaced, and rides on its frame.
    assert (marker.lifetime.sec, marker.lifetime.nanosec, marker.frame_locked) == (0, 0, True), topic
    assert (marker.id, marker.action) == (0, 0) and marker.ns, topic


def read(path):
    """Messages of each topic, and the times of the surfaces in seconds."""
    try:
        from mcap.reader import make_reader
        from mcap_ros2.reader import read_ros2_messages
    except ImportError:
        needs("mcap-ros2-support")
    with open(path, "rb") as file:
        reader = make_reader(file)
        summary = reader.get_summary()
        assert reader.get_header().profile == "ros2"
        assert {index.compression for index in summary.chunk_indexes} == {"lz4"}
    count, surfaces, known, before = defaultdict(int), [], {"world"}, 0
    for message in read_ros2_messages(str(path)):
        topic, content, now = message.channel.topic, message.ros_msg, message.log_time_ns
        count[topic] += 1
        assert now >= before, f"{topic}: time runs backwards"
        before = now
        if topic == "/tf":
            for transform in content.transforms:
                assert transform.header.frame_id == "world"
                known.add(transform.child_frame_id)
            continue
        parts = content.markers if hasattr(content, "markers") else [content]
        for part in parts:
            header = getattr(part, "header", None)
            if header is not None:
                assert header.frame_id in known, f"{topic}: frame {header.frame_id} is not known yet"
                assert header.stamp.sec * 10**9 + header.stamp.nanosec == now, topic
        if hasattr(content, "fields"):
            check_cloud(topic, content)
        if hasattr(content, "markers"):
            check_marker(topic, content.markers[0])
        if topic == "/surface":
            surfaces.append(now / 1e9)
    assert sum(count.values()) == summary.statistics.message_count
    return count, surfaces


def coloured(picture):
    """Share of the pixels that are more than grey."""
    return (picture.max(axis=2) - picture.min(axis=2) > 40).mean()


def look(path, moments, folder):
    """Pictures of the scene at each of the moments."""
    try:
        import numpy
        from PIL import Image
        from rerun.experimental import ViewerClient
    except ImportError:
        needs("rerun-sdk and pillow")
    os.environ.setdefault("RERUN_ANALYTICS_ENABLED", "0")
    os.environ.setdefault("XDG_RUNTIME_DIR", tempfile.mkdtemp())
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    program = Path(sys.executable).with_name("rerun")
    chosen = {"executable_path": str(program)} if program.exists() else {}
    pictures = []
    with ViewerClient.spawn(headless=True, port=port, hide_welcome_screen=True, **chosen) as viewer:
        viewer.open(str(path.resolve()))
        patience = time.monotonic() + 120
        while (state := viewer.get_state()).loading or not state.views:
            assert time.monotonic() < patience, "Rerun does not come to an end"
            time.sleep(0.5)
        scene = next(view for view in state.views if view.view_class == "3D")
        for number, moment in enumerate(moments):
            viewer.set_time("message_log_time", timestamp=moment, play_state="paused")
            time.sleep(1.5)
            image = viewer.take_screenshot(scene.view_id, max_size=1000)
            for view in viewer.get_state().views:
                assert not view.reports, f"{view.name}: {view.reports}"
            if folder is not None:
                (folder / f"rerun-{number}.png").write_bytes(image)
            pictures.append(numpy.asarray(Image.open(io.BytesIO(image)).convert("RGB"), int))
    return pictures


def main():
    if len(sys.argv) not in (2, 3):
        sys.exit(__doc__)
    path = Path(sys.argv[1])
    folder = Path(sys.argv[2]) if len(sys.argv) == 3 else None
    count, surfaces = read(path)
    for topic, messages in sorted(count.items()):
        print(f"{topic:32}{messages:8}")
    if len(surfaces) < 3:
        needs("a recording with a surface that grows")
    moments = [surfaces[0], surfaces[len(surfaces) // 2], surfaces[-1]]
    pictures = look(path, moments, folder)
    shares = [coloured(picture) for picture in pictures]
    print("coloured at", ", ".join(f"{t:.1f} s: {100 * s:.1f} %" for t, s in zip(moments, shares)))
    # An outline is thin.
    assert all(share > 1e-3 for share in shares), "nothing is seen"
    assert (pictures[0] != pictures[-1]).any(axis=2).mean() > 1e-3, "it does not change"


main()
