# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The ROS node shadows no attribute of rclpy's node: its own list `_services` would end the parameter services."""

import ast

import pytest

PRIVATE = """
_allow_undeclared_parameters _apply_descriptor _apply_descriptor_and_set _apply_descriptors _apply_floating_point_range
_apply_integer_range _call_post_set_parameters_callback _call_pre_set_parameters_callback _callbacks
_check_undeclared_parameters _clients _clock _context _count_clients_or_servers _count_publishers_or_subscribers
_declare_parameter_common _default_callback_group _descriptors _get_info_by_topic _guards _logger _managed_entities
_on_set_parameters_callbacks _parameter_event_publisher _parameter_overrides _parameter_service _parameters
_post_set_parameters_callbacks _pre_set_parameters_callbacks _publishers _rate_group _service_change_state
_service_get_available_states _service_get_available_transitions _service_get_state _service_get_transition_graph _services
_set_parameters_atomically _set_parameters_atomically_common _state_machine _subscriptions _time_source _timers
_type_description_service _validate_qos_or_depth_parameter _validate_topic_or_service_name _wake_executor
"""
"""Private attributes of rclpy.lifecycle.LifecycleNode of Jazzy, which a subclass shares."""
OVERRIDDEN = {"default_callback_group", "destroy_node", "on_activate", "on_cleanup", "on_configure", "on_deactivate"}


def stored(text):
    """Attributes that the methods of the node assign, and its methods."""
    (node,) = (item for item in ast.parse(text).body if isinstance(item, ast.ClassDef) and item.name == "EstimatorNode")
    methods = {item.name for item in node.body if isinstance(item, ast.FunctionDef)}
    targets = (item for item in ast.walk(node) if isinstance(item, ast.Attribute) and isinstance(item.ctx, ast.Store))
    return methods | {target.attr for target in targets if ast.unparse(target.value) == "self"}


@pytest.fixture(scope="module")
def names(repository):
    return stored((repository / "trackres_ros" / "node" / "ros" / "node.py").read_text(encoding="utf-8"))


def test_the_ros_node_shadows_no_private_attribute_of_rclpy(names):
    assert {"application", "_configure", "_outputs"} <= names
    assert not names & set(PRIVATE.split())


def test_the_ros_node_overrides_only_what_rclpy_calls(names):
    rclpy = pytest.importorskip("rclpy", reason="needs ROS 2: rclpy", exc_type=ImportError)
    from rclpy.lifecycle import LifecycleNode

    context = rclpy.Context()
    rclpy.init(context=context)
    node = LifecycleNode("names", context=context)
    attributes = {*vars(node), *dir(LifecycleNode)}
    node.destroy_node()
    rclpy.shutdown(context=context)
    assert {name for name in names & attributes if not name.startswith("__")} == OVERRIDDEN
    assert {name for name in attributes if name.startswith("_") and "__" not in name} <= set(
        PRIVATE.split()
    )  # the list is complete
