"""Reads session logs with public packages only: every message by the schema in the file, Foxglove's also by the published one."""
import struct
import sys

from foxglove_schemas_protobuf import PoseInFrame_pb2, PosesInFrame_pb2
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

PUBLISHED = {
    "foxglove.PoseInFrame": PoseInFrame_pb2.PoseInFrame,
    "foxglove.PosesInFrame": PosesInFrame_pb2.PosesInFrame,
}
for name in ("RawImage", "CompressedImage"):
    module = __import__(f"foxglove_schemas_protobuf.{name}_pb2", fromlist=[name])
    PUBLISHED[f"foxglove.{name}"] = getattr(module, name)


def bits(value):
    return struct.pack("<d", value)


def numbers(pose):
    p, q = pose.position, pose.orientation
    return [bits(x) for x in (p.x, p.y, p.z, q.x, q.y, q.z, q.w)]


files = messages = foxglove = 0
for path in sys.argv[1:]:
    with open(path, "rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()], validate_crcs=True)
        assert reader.get_header().profile == "vergence", path
        summary = reader.get_summary()
        sessions = [record for record in reader.iter_metadata() if record.name == "vergence.session"]
        assert len(sessions) == 1 and sessions[0].metadata["format_version"] == "1", path
        count = 0
        # A stable sort by log time is the order of the file.
        for schema, channel, message, decoded in reader.iter_decoded_messages():
            count += 1
            if schema.name not in PUBLISHED:
                assert schema.name.startswith("vergence.") and decoded.arrived_ns is not None, schema.name
                assert message.log_time == max(0, decoded.arrived_ns), path
                continue
            foxglove += 1
            published = PUBLISHED[schema.name]()
            published.ParseFromString(message.data)
            assert published.frame_id == decoded.frame_id == channel.metadata["frame"]
            captured = published.timestamp.seconds * 1_000_000_000 + published.timestamp.nanos
            assert message.publish_time == max(0, captured), path
            assert message.log_time == max(0, decoded.arrived_ns), path
            if schema.name == "foxglove.PoseInFrame":
                assert numbers(published.pose) == numbers(decoded.pose)
            elif schema.name == "foxglove.PosesInFrame":
                assert [numbers(p) for p in published.poses] == [numbers(p) for p in decoded.poses]
            else:
                assert published.data == decoded.data and len(published.data) > 0
        # A recording that failed has no summary.
        assert count > 0 if summary is None else count == summary.statistics.message_count, path
        files, messages = files + 1, messages + count
print(f"{files} files, {messages} messages, {foxglove} of Foxglove's")
