"""Definitions of the ROS messages that are spoken, as ``.msg`` files have them, without comments.

They are the same in Humble, Jazzy, Kilted and Lyrical.
"""

from __future__ import annotations

from typing import Final

BOOL: Final = "std_msgs/msg/Bool"
ODOMETRY: Final = "nav_msgs/msg/Odometry"
TF: Final = "tf2_msgs/msg/TFMessage"
JOINT_STATE: Final = "sensor_msgs/msg/JointState"
DIAGNOSTICS: Final = "diagnostic_msgs/msg/DiagnosticArray"
TWIST: Final = "geometry_msgs/msg/Twist"
TWIST_STAMPED: Final = "geometry_msgs/msg/TwistStamped"
ACKERMANN: Final = "ackermann_msgs/msg/AckermannDriveStamped"
TRIGGER: Final = "std_srvs/srv/Trigger"
TRIGGER_REQUEST: Final = f"{TRIGGER}_Request"
TRIGGER_RESPONSE: Final = f"{TRIGGER}_Response"

DEFINITIONS: Final = {
    "builtin_interfaces/msg/Time": "int32 sec\nuint32 nanosec",
    "std_msgs/msg/Header": "builtin_interfaces/Time stamp\nstring frame_id",
    BOOL: "bool data",
    "geometry_msgs/msg/Vector3": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/msg/Point": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/msg/Quaternion": "float64 x 0\nfloat64 y 0\nfloat64 z 0\nfloat64 w 1",
    "geometry_msgs/msg/Pose": "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation",
    "geometry_msgs/msg/PoseWithCovariance": "geometry_msgs/Pose pose\nfloat64[36] covariance",
    TWIST: "geometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular",
    "geometry_msgs/msg/TwistWithCovariance": "geometry_msgs/Twist twist\nfloat64[36] covariance",
    TWIST_STAMPED: "std_msgs/Header header\ngeometry_msgs/Twist twist",
    "geometry_msgs/msg/Transform": "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation",
    "geometry_msgs/msg/TransformStamped": (
        "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/Transform transform"
    ),
    TF: "geometry_msgs/TransformStamped[] transforms",
    ODOMETRY: (
        "std_msgs/Header header\nstring child_frame_id\n"
        "geometry_msgs/PoseWithCovariance pose\ngeometry_msgs/TwistWithCovariance twist"
    ),
    JOINT_STATE: (
        "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort"
    ),
    "diagnostic_msgs/msg/KeyValue": "string key\nstring value",
    "diagnostic_msgs/msg/DiagnosticStatus": (
        "byte OK=0\nbyte WARN=1\nbyte ERROR=2\nbyte STALE=3\n"
        "byte level\nstring name\nstring message\nstring hardware_id\ndiagnostic_msgs/KeyValue[] values"
    ),
    DIAGNOSTICS: "std_msgs/Header header\ndiagnostic_msgs/DiagnosticStatus[] status",
    "ackermann_msgs/msg/AckermannDrive": (
        "float32 steering_angle\nfloat32 steering_angle_velocity\n"
        "float32 speed\nfloat32 acceleration\nfloat32 jerk"
    ),
    ACKERMANN: "std_msgs/Header header\nackermann_msgs/AckermannDrive drive",
    "service_msgs/msg/ServiceEventInfo": (
        "uint8 REQUEST_SENT=0\nuint8 REQUEST_RECEIVED=1\nuint8 RESPONSE_SENT=2\nuint8 RESPONSE_RECEIVED=3\n"
        "uint8 event_type\nbuiltin_interfaces/Time stamp\nchar[16] client_gid\nint64 sequence_number"
    ),
    # An empty structure has one member in CDR.
    TRIGGER_REQUEST: "uint8 structure_needs_at_least_one_member",
    TRIGGER_RESPONSE: "bool success\nstring message",
    f"{TRIGGER}_Event": (
        f"service_msgs/ServiceEventInfo info\n{TRIGGER}_Request[<=1] request\n{TRIGGER}_Response[<=1] response"
    ),
    TRIGGER: (
        f"{TRIGGER}_Request request_message\n{TRIGGER}_Response response_message\n{TRIGGER}_Event event_message"
    ),
}
"""By full name. Within a definition, a message of a package is named as in ``.msg`` files, without ``msg``."""
