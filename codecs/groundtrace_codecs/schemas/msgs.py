"""``ros2msg`` schemas of the ROS 2 messages that groundtrace writes.

Fields and constants are those of the ROS 2 packages std_msgs, geometry_msgs and sensor_msgs as
Jazzy has them, without their comments: the types have the same hash (REP 2016).
"""

from __future__ import annotations

_DEFINITIONS = {
    "builtin_interfaces/Time": ("int32 sec", "uint32 nanosec"),
    "std_msgs/Header": ("builtin_interfaces/Time stamp", "string frame_id"),
    "geometry_msgs/Vector3": ("float64 x", "float64 y", "float64 z"),
    "geometry_msgs/Quaternion": ("float64 x", "float64 y", "float64 z", "float64 w"),
    "sensor_msgs/Imu": (
        "std_msgs/Header header",
        "geometry_msgs/Quaternion orientation",
        "float64[9] orientation_covariance",
        "geometry_msgs/Vector3 angular_velocity",
        "float64[9] angular_velocity_covariance",
        "geometry_msgs/Vector3 linear_acceleration",
        "float64[9] linear_acceleration_covariance",
    ),
    "sensor_msgs/MagneticField": (
        "std_msgs/Header header",
        "geometry_msgs/Vector3 magnetic_field",
        "float64[9] magnetic_field_covariance",
    ),
    "sensor_msgs/FluidPressure": (
        "std_msgs/Header header",
        "float64 fluid_pressure",
        "float64 variance",
    ),
    "sensor_msgs/Temperature": (
        "std_msgs/Header header",
        "float64 temperature",
        "float64 variance",
    ),
    "sensor_msgs/NavSatStatus": (
        "int8 STATUS_UNKNOWN=-2",
        "int8 STATUS_NO_FIX=-1",
        "int8 STATUS_FIX=0",
        "int8 STATUS_SBAS_FIX=1",
        "int8 STATUS_GBAS_FIX=2",
        "int8 status",
        "uint16 SERVICE_UNKNOWN=0",
        "uint16 SERVICE_GPS=1",
        "uint16 SERVICE_GLONASS=2",
        "uint16 SERVICE_COMPASS=4",
        "uint16 SERVICE_GALILEO=8",
        "uint16 service",
    ),
    "sensor_msgs/NavSatFix": (
        "std_msgs/Header header",
        "sensor_msgs/NavSatStatus status",
        "float64 latitude",
        "float64 longitude",
        "float64 altitude",
        "float64[9] position_covariance",
        "uint8 COVARIANCE_TYPE_UNKNOWN=0",
        "uint8 COVARIANCE_TYPE_APPROXIMATED=1",
        "uint8 COVARIANCE_TYPE_DIAGONAL_KNOWN=2",
        "uint8 COVARIANCE_TYPE_KNOWN=3",
        "uint8 position_covariance_type",
    ),
    "std_msgs/MultiArrayDimension": ("string label", "uint32 size", "uint32 stride"),
    "std_msgs/MultiArrayLayout": (
        "std_msgs/MultiArrayDimension[] dim",
        "uint32 data_offset",
    ),
    "std_msgs/Float64MultiArray": ("std_msgs/MultiArrayLayout layout", "float64[] data"),
}


def ros2msg(name: str) -> str:
    """Return the ``ros2msg`` schema of one of the messages, e.g. ``sensor_msgs/Imu``."""
    needed = [name]
    for known in needed:
        kinds = (line.split()[0].removesuffix("[]") for line in _DEFINITIONS[known])
        needed += [k for k in dict.fromkeys(kinds) if k in _DEFINITIONS and k not in needed]
    head, *others = ("\n".join(_DEFINITIONS[n]) for n in needed)
    rule = "\n" + "=" * 80 + "\n"
    return head + "".join(
        f"{rule}MSG: {other}\n{text}" for other, text in zip(needed[1:], others, strict=True)
    )
