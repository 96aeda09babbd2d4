"""Message schemas: protobuf and ROS 2, their bytes to arrays and back."""
