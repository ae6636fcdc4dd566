"""The transport on ROS 2: messages in, messages out; the only place that imports rclpy."""
