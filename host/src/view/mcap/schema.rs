//! The ROS 2 message types that a recording uses, as their packages define them (`common_interfaces`,
//! `geometry2` and `rcl_interfaces`, Humble and later), without comments.

const RULE: &str =
    "================================================================================\n";

/// Name and fields of every type, each after the ones it is made of.
const TYPES: &[(&str, &str)] = &[
    ("builtin_interfaces/msg/Time", "int32 sec\nuint32 nanosec\n"),
    ("builtin_interfaces/msg/Duration", "int32 sec\nuint32 nanosec\n"),
    ("std_msgs/msg/Header", "builtin_interfaces/Time stamp\nstring frame_id\n"),
    ("std_msgs/msg/ColorRGBA", "float32 r\nfloat32 g\nfloat32 b\nfloat32 a\n"),
    ("std_msgs/msg/Float64", "float64 data\n"),
    ("std_msgs/msg/String", "string data\n"),
    ("geometry_msgs/msg/Point", "float64 x\nfloat64 y\nfloat64 z\n"),
    ("geometry_msgs/msg/Vector3", "float64 x\nfloat64 y\nfloat64 z\n"),
    ("geometry_msgs/msg/Quaternion", "float64 x 0\nfloat64 y 0\nfloat64 z 0\nfloat64 w 1\n"),
    ("geometry_msgs/msg/Pose", "Point position\nQuaternion orientation\n"),
    ("geometry_msgs/msg/PoseArray", "std_msgs/Header header\nPose[] poses\n"),
    ("geometry_msgs/msg/PoseStamped", "std_msgs/Header header\nPose pose\n"),
    ("geometry_msgs/msg/PoseWithCovariance", "Pose pose\nfloat64[36] covariance\n"),
    (
        "geometry_msgs/msg/PoseWithCovarianceStamped",
        "std_msgs/Header header\nPoseWithCovariance pose\n",
    ),
    ("geometry_msgs/msg/Transform", "Vector3 translation\nQuaternion rotation\n"),
    (
        "geometry_msgs/msg/TransformStamped",
        "std_msgs/Header header\nstring child_frame_id\nTransform transform\n",
    ),
    ("tf2_msgs/msg/TFMessage", "geometry_msgs/TransformStamped[] transforms\n"),
    (
        "sensor_msgs/msg/PointField",
        "uint8 INT8 = 1\nuint8 UINT8 = 2\nuint8 INT16 = 3\nuint8 UINT16 = 4\nuint8 INT32 = 5\n\
         uint8 UINT32 = 6\nuint8 FLOAT32 = 7\nuint8 FLOAT64 = 8\n\
         string name\nuint32 offset\nuint8 datatype\nuint32 count\n",
    ),
    (
        "sensor_msgs/msg/PointCloud2",
        "std_msgs/Header header\nuint32 height\nuint32 width\nPointField[] fields\n\
         bool is_bigendian\nuint32 point_step\nuint32 row_step\nuint8[] data\nbool is_dense\n",
    ),
    ("sensor_msgs/msg/CompressedImage", "std_msgs/Header header\nstring format\nuint8[] data\n"),
    ("visualization_msgs/msg/UVCoordinate", "float32 u\nfloat32 v\n"),
    ("visualization_msgs/msg/MeshFile", "string filename\nuint8[] data\n"),
    (
        "visualization_msgs/msg/Marker",
        "int32 ARROW=0\nint32 CUBE=1\nint32 SPHERE=2\nint32 CYLINDER=3\nint32 LINE_STRIP=4\n\
         int32 LINE_LIST=5\nint32 CUBE_LIST=6\nint32 SPHERE_LIST=7\nint32 POINTS=8\n\
         int32 TEXT_VIEW_FACING=9\nint32 MESH_RESOURCE=10\nint32 TRIANGLE_LIST=11\n\
         int32 ARROW_STRIP=12\nint32 ADD=0\nint32 MODIFY=0\nint32 DELETE=2\nint32 DELETEALL=3\n\
         std_msgs/Header header\nstring ns\nint32 id\nint32 type\nint32 action\n\
         geometry_msgs/Pose pose\ngeometry_msgs/Vector3 scale\nstd_msgs/ColorRGBA color\n\
         builtin_interfaces/Duration lifetime\nbool frame_locked\n\
         geometry_msgs/Point[] points\nstd_msgs/ColorRGBA[] colors\n\
         string texture_resource\nsensor_msgs/CompressedImage texture\n\
         UVCoordinate[] uv_coordinates\nstring text\nstring mesh_resource\nMeshFile mesh_file\n\
         bool mesh_use_embedded_materials\n",
    ),
    ("visualization_msgs/msg/MarkerArray", "Marker[] markers\n"),
];

/// The definition of type `name` in the encoding `ros2msg`: its fields, then every type they are
/// made of behind a rule and its name. Empty for a name that is not here.
pub(super) fn definition(name: &str) -> String {
    let mut needed = vec![name.to_owned()];
    let mut text = String::new();
    let mut next = 0;
    while let Some(name) = needed.get(next).cloned() {
        next += 1;
        let Some((_, fields)) = TYPES.iter().find(|(n, _)| *n == name) else { continue };
        if next > 1 {
            text += &format!("{RULE}MSG: {}\n", name.replacen("/msg/", "/", 1));
        }
        text += fields;
        for part in fields.lines().filter_map(|line| part(&name, line)) {
            if !needed.contains(&part) {
                needed.push(part);
            }
        }
    }
    text
}

/// The full name of the type of one field, unless it is one of the language's own.
fn part(owner: &str, line: &str) -> Option<String> {
    let kind = line.split_whitespace().next()?.split('[').next()?;
    match kind.split_once('/') {
        Some((package, name)) => Some(format!("{package}/msg/{name}")),
        None if kind.starts_with(char::is_uppercase) => {
            Some(format!("{}/msg/{kind}", owner.split('/').next()?))
        }
        None => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn definitions_carry_what_they_are_made_of_once() {
        let text = definition("geometry_msgs/msg/PoseStamped");
        assert!(text.starts_with("std_msgs/Header header\nPose pose\n====="), "{text}");
        for (kind, times) in [
            ("std_msgs/Header", 1),
            ("builtin_interfaces/Time", 1),
            ("geometry_msgs/Pose", 1),
            ("geometry_msgs/Point", 1),
            ("geometry_msgs/Quaternion", 1),
            ("geometry_msgs/Vector3", 0),
        ] {
            assert_eq!(text.matches(&format!("MSG: {kind}\n")).count(), times, "{kind}");
        }
    }

    #[test]
    fn every_part_of_every_type_is_known() {
        for (name, fields) in TYPES {
            for part in fields.lines().filter_map(|line| part(name, line)) {
                assert!(TYPES.iter().any(|(known, _)| *known == part), "{name}: {part}");
            }
        }
        assert_eq!(definition("no_msgs/msg/Such"), "");
    }
}
