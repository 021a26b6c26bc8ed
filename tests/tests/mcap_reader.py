"""Reads an MCAP file of `tactile` with somebody else's libraries and prints what is in it as JSON.

Needs `mcap-ros2-support` (pip). Decoding goes by the schemas in the file alone.
"""

import json
import math
import struct
import sys

from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

with open(sys.argv[1], "rb") as file:
    reader = make_reader(file, decoder_factories=[DecoderFactory()])
    summary = reader.get_summary()
    assert reader.get_header().profile == "ros2"
    assert summary.chunk_indexes and all(c.compression == "lz4" for c in summary.chunk_indexes)
    topics, last, frames = {}, {}, set()
    for schema, channel, message, decoded in reader.iter_decoded_messages():
        topics[channel.topic] = topics.get(channel.topic, 0) + 1
        last[channel.topic] = decoded
        header = getattr(decoded, "header", None)
        if header is not None:
            stamp = header.stamp.sec * 10**9 + header.stamp.nanosec
            assert stamp == message.log_time, channel.topic
            frames.add(header.frame_id)
    assert sum(topics.values()) == summary.statistics.message_count


def points(cloud, *names):
    """The named fields (all of four bytes) of every point."""
    kinds = {5: "<i", 6: "<I", 7: "<f"}
    fields = {f.name: (f.offset, kinds[f.datatype]) for f in cloud.fields}
    data = bytes(cloud.data)
    assert len(data) == cloud.width * cloud.point_step == cloud.row_step
    return [
        [struct.unpack_from(fields[n][1], data, i + fields[n][0])[0] for n in names]
        for i in range(0, len(data), cloud.point_step)
    ]


contacts = points(last["/object/contacts"], "x", "y", "z", "normal_x", "normal_y", "normal_z")
lengths = [math.hypot(*c[3:]) for c in contacts]
orientation = last["/pose"].pose.orientation
marker = last["/surface"].markers[0]
print(
    json.dumps(
        {
            "topics": topics,
            "frames": sorted(frames),
            "contacts": len(contacts),
            "normals": [min(lengths), max(lengths)],
            "quaternion": math.hypot(orientation.x, orientation.y, orientation.z, orientation.w),
            "position": [getattr(last["/pose"].pose.position, axis) for axis in "xyz"],
            "children": [t.child_frame_id for t in last["/tf"].transforms],
            "marker": [marker.type, len(marker.points), len(marker.colors)],
            "hausdorff_mm": last["/report/hausdorff_mm"].data,
        }
    )
)
