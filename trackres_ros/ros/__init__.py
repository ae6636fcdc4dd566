"""The edge on ROS 2: the only place that imports rclpy."""
