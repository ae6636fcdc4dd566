"""The edge on Cyclone DDS, for machines where ROS 2 is not installed: topics and presence, as a ROS 2 node shows them."""
