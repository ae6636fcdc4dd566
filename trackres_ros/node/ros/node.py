# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The live node on ROS 2: a lifecycle node that lends its middleware to the application."""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any

from lifecycle_msgs.srv import ChangeState
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.clock import Clock, ClockType, JumpThreshold
from rclpy.duration import Duration
from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.parameter import Parameter as RosParameter
from rclpy.qos import DurabilityPolicy, QoSCompatibility, QoSProfile, ReliabilityPolicy, qos_check_compatible
from rclpy.serialization import serialize_message
from rclpy.subscription import Subscription
from rclpy.timer import Timer
from rosgraph_msgs.msg import Clock as ClockMessage
from std_srvs.srv import Trigger

from trackres_ros.errors import InputError
from trackres_ros.node.application import Application
from trackres_ros.node.inputs import Arrival, Sent
from trackres_ros.node.parameters import Parameters, make_parameters
from trackres_ros.node.ros import interface
from trackres_ros.node.transport import DISCOVERY_NS, NAMELESS, TORQUES, InputTopic, Level, Peer, Reasons, Status
from trackres_ros.output.topics import DEFAULT_NODE, ESTIMATE_TOPIC, OutputTopic
from trackres_ros.units import SECOND_NS

COLLECTED_FROM_HZ = 20.0  # of the outputs: the inputs' queues hold the messages between two of them, at 1 kHz too
MOST_COLLECTED = 1000  # of a topic at a time
UNKNOWN = "_NODE_NAME_UNKNOWN_"  # of a publisher that no node announces, see rmw/get_topic_endpoint_info.h
Taken = tuple[Any, dict[str, int], bool]
"""A message, its middleware information, and whether it came by a subscription that also gets what publishers keep."""


class OneAtATime(MutuallyExclusiveCallbackGroup):  # type: ignore[misc]
    """The group of all callbacks of a node: any executor runs one at a time, so messages keep the order in which they are taken.

    Sometimes the executor excludes some of them from its wait. rclpy builds its wait set again for each message, from every
    entity that may run. With dozens of services and event handlers in it that takes longer than the estimate itself.
    """

    def __init__(self) -> None:
        super().__init__()
        self.inputs: list[Any] = []  # subscriptions that feed the estimate
        self.waits_for_inputs = True  # for their messages; else the next tick collects them
        self.serves = True  # services and events; not from a message until the next tick

    def can_execute(self, entity: Any) -> bool:
        """Whether the executor waits for it, or runs it."""
        if isinstance(entity, Subscription):  # others are rclpy's own, of /clock, or only recorded
            is_open = self.waits_for_inputs or entity not in self.inputs
        else:
            is_open = self.serves or isinstance(entity, Timer)
        return is_open and bool(super().can_execute(entity))


class EstimatorNode(LifecycleNode):  # type: ignore[misc]
    """The node; see docs/node.md.

    Parameters
    ----------
    values
        Replacements for the defaults of the parameters.
    arguments
        Of `rclpy.node.Node`: namespace, context, cli_args, parameter_overrides...
    """

    def __init__(self, values: Parameters | None = None, node: str = DEFAULT_NODE, **arguments: Any) -> None:
        self._group = OneAtATime()
        self.application: Application | None = None
        self.configured: Callable[[Application], None] | None = None  # called with each application that is made
        self.failure = ""
        self.refusal: InputError | None = None  # refusal of the last transition
        self._clear()
        self._made_ns = time.monotonic_ns()
        super().__init__(node, **arguments)
        self.add_pre_set_parameters_callback(interface.own_types)
        self.add_on_set_parameters_callback(self._check)
        interface.declare_parameters(self, values or make_parameters({}))
        self.add_post_set_parameters_callback(self._apply)
        self.log_warning(interface.unknown_parameters(self, of_topics=False))
        for service in self.services:
            if service.srv_type is ChangeState:
                service.callback = _with_answer(service.callback)

    def _clear(self) -> None:
        """Before configuration or after cleanup."""
        self._fills: list[interface.Fill | None] = []
        self._outputs: dict[int, Any] = {}  # without those whose type is not installed
        self._latched: dict[int, Any] = {}
        self._inputs: list[Any] = []
        self._group.inputs = self._inputs
        self._record_only: list[Any] = []
        self._triggers: list[Any] = []
        self._jumps: Any = None
        self._refused_ns = 0  # last time of /clock before 0, while there is no later one
        self._ticker: Any = None
        self._recording = False

    @property
    def default_callback_group(self) -> OneAtATime:
        """The group of all callbacks."""
        return self._group

    # Lifecycle

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Make the application and connect it."""
        return self._transition(self._configure, state)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Begin to publish."""
        return self._transition(self._activate, state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Let the feed-forward go to zero and stop publishing; the estimate continues."""
        return self._transition(self._deactivate, state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Save the state and release everything, so that the node can be configured again."""
        return self._transition(lambda _: self.release(), state)

    on_shutdown = on_error = on_cleanup

    def _transition(self, step: Callable[[LifecycleState], None], state: LifecycleState) -> TransitionCallbackReturn:
        """Do a transition; rclpy would swallow an exception, so it is logged and reported."""
        try:
            step(state)
        except InputError as error:
            self.failure, self.refusal = str(error), error
            self.get_logger().error(self.failure)
            self.release()
            return TransitionCallbackReturn.FAILURE
        except Exception as error:
            self.failure = f"{type(error).__name__}: {error}"
            self.get_logger().error("".join(traceback.format_exception(error)))
            return TransitionCallbackReturn.ERROR
        return TransitionCallbackReturn.SUCCESS

    def _configure(self, _state: LifecycleState) -> None:
        parameters = interface.read_parameters(self)
        self._frame_id = parameters.text("frame_id")
        application = Application(parameters, self, self.get_name(), self.get_namespace())
        kinds = [interface.input_type(topic, application.topics.origin) for topic in application.inputs]
        self.application = application
        self._fills = [None if topic.kind == "status" else self._fill(topic) for topic in application.outputs]
        self._open(is_shared=True)
        time.sleep(max(0, self._made_ns + DISCOVERY_NS - time.monotonic_ns()) / SECOND_NS)
        if not self.rivals():
            self._open(is_shared=False)
        self._input_profile = interface.profile_of(parameters.input_quality())
        for topic, kind in zip(application.inputs, kinds, strict=True):
            profile = interface.profile_of(parameters.input_quality())  # its own: overrides are written into it
            self._open_input(topic.name, kind, profile)
        self._inbox = application.inbox(self._fetch, self._deliver)
        self._triggers = [
            self.create_service(Trigger, "~/reset", self._server(application.reset)),
            self.create_service(Trigger, "~/reset_learning", self._server(application.reset_learning)),
            self.create_service(Trigger, "~/save_state", self._server(application.save_state)),
        ]
        self._start_clocks(application)
        self._wait_or_collect(application)
        self.log_warning(interface.unknown_parameters(self, of_topics=True))
        self.get_logger().info(f"{application.vehicle.title}; {application.began_with}")
        if self.configured:
            self.configured(application)

    def _open(self, is_shared: bool) -> None:
        """Open the outputs on topics that nodes share, or those below the node's own name; each once."""
        assert self.application
        for output, topic in enumerate(self.application.outputs):
            lacks_type = topic is ESTIMATE_TOPIC and self._fills[output] is None
            if topic.shared is is_shared and output not in self._outputs and not lacks_type:
                self._outputs[output] = self._publisher_of(topic, self.application.parameters)

    def _publisher_of(self, topic: OutputTopic, parameters: Parameters) -> Any:
        name = _relative_name(topic)
        profile = interface.profile_of(parameters.output_quality(topic))
        events = PublisherEventCallbacks(
            incompatible_qos=self._reporter(f"a subscriber of {self.resolve_topic_name(name)}"), use_default_callbacks=False
        )
        kind = interface.installed_type(topic.type, f"topic {name}")
        with interface.override_errors(self, name):
            return self.create_lifecycle_publisher(
                kind, name, profile, event_callbacks=events, qos_overriding_options=interface.OVERRIDABLE
            )

    def _open_input(self, name: str, kind: Any, profile: QoSProfile) -> None:
        events = SubscriptionEventCallbacks(
            incompatible_qos=self._reporter(f"a publisher of {self.topic_name(name)}"), use_default_callbacks=False
        )
        take = self._taker(len(self._inputs), latched=False)
        with interface.override_errors(self, name):
            subscription = self.create_subscription(
                kind, name, take, profile, event_callbacks=events, qos_overriding_options=interface.OVERRIDABLE
            )
        self._inputs.append(subscription)

    def _start_clocks(self, application: Application) -> None:
        """Notify the application when the clock goes back, and call its tick by steady time."""
        self._next_tick = 0
        any_back = JumpThreshold(min_forward=None, min_backward=Duration(nanoseconds=-1), on_clock_change=False)

        def note_jump(jump: Any) -> None:
            application.guard.essential("the clock", application.time_went_back, -jump.delta.nanoseconds)

        self._jumps = self.get_clock().create_jump_callback(any_back, post_callback=note_jump)
        for subscription in self.subscriptions:
            if subscription.msg_type is ClockMessage:
                subscription.callback = self._without_negative(subscription.callback)
        self._steady_clock = Clock(clock_type=ClockType.STEADY_TIME)
        self._ticker = self.create_timer(application.period_s, self._tick, clock=self._steady_clock)

    def _without_negative(self, take: Callable[[Any], None]) -> Callable[[Any], None]:
        """The callback of /clock, without the times before 0 at which rclpy raises."""

        def take_message(message: Any) -> None:
            time_ns = message.clock.sec * SECOND_NS + message.clock.nanosec
            if time_ns < 0 and not self._refused_ns and self.application:
                self.application.time_went_back(self.now_ns())
            self._refused_ns = min(0, time_ns)
            if time_ns >= 0:
                take(message)

        return take_message

    def _activate(self, state: LifecycleState) -> None:
        super().on_activate(state)
        assert self.application
        self.application.activate()

    def _deactivate(self, state: LifecycleState) -> None:
        assert self.application
        self.application.deactivate(on_wait=self._run_executor)
        super().on_deactivate(state)

    def _run_executor(self) -> None:
        """Do what the executor would do. A simulated clock stands still meanwhile, so messages wait for it."""
        if self.application and not self.application.parameters.sim_time:
            self._collect()
        self._tick_if_due()

    def release(self) -> None:
        """Let the feed-forward go to zero, save the state, and destroy everything that `on_configure` made."""
        application, self.application = self.application, None
        if application is None:
            return
        self.get_logger().info(application.close())
        if self._jumps:
            self._jumps.unregister()
        if self._ticker:
            self.destroy_timer(self._ticker)
        for subscription in (*self._inputs, *self._latched.values(), *self._record_only):
            self.destroy_subscription(subscription)
        for output in self._outputs.values():
            self.destroy_lifecycle_publisher(output)
        for service in self._triggers:
            self.destroy_service(service)
        self._clear()

    def destroy_node(self) -> None:
        """Release everything, which lets the feed-forward go to zero, and destroy the node."""
        self.release()
        super().destroy_node()

    # Interface of the application's transport

    def _fill(self, topic: OutputTopic) -> interface.Fill | None:
        """None for an estimate whose type is not installed, or differs: it alone is not among the common interfaces."""
        try:
            return interface.prepare_message(topic, self._frame_id)
        except (InputError, AttributeError, AssertionError, TypeError) as error:  # not there, or of another version
            if topic is not ESTIMATE_TOPIC:
                raise
            self.get_logger().info(f"~/{ESTIMATE_TOPIC.name} is not published, all other topics are: {error}")
            return None

    def now_ns(self) -> int:
        """The node's time, simulated where use_sim_time is set."""
        return self._refused_ns or int(self.get_clock().now().nanoseconds)

    def publish(self, output: int, stamp_ns: int, values: Sequence[float], reasons: Reasons) -> None:
        """Publish a message of numbers, where its type is installed."""
        if fill := self._fills[output]:
            self._outputs[output].publish(fill(stamp_ns, values, reasons))

    def publish_status(self, output: int, stamp_ns: int, statuses: Sequence[Status]) -> None:
        """Publish a DiagnosticArray."""
        self._outputs[output].publish(interface.diagnostic_array(stamp_ns, statuses, self._frame_id))

    def peers(self, index: int) -> Sequence[Peer]:
        """The publishers on the topic of an input."""
        subscription = self._inputs[index]
        own_names = {
            endpoint.topic_type: endpoint.topic_type_hash
            for endpoint in self.get_subscriptions_info_by_topic(subscription.topic_name)
            if (endpoint.node_name, endpoint.node_namespace) == (self.get_name(), self.get_namespace())
        }
        return [
            Peer(
                endpoint.topic_type,
                qos_check_compatible(endpoint.qos_profile, subscription.qos_profile)[0] != QoSCompatibility.ERROR,
                endpoint.topic_type_hash.version <= 0
                or endpoint.topic_type_hash == own_names.get(endpoint.topic_type, endpoint.topic_type_hash),
                _node_of(endpoint),
                latched=_keeps_last(endpoint.qos_profile),
            )
            for endpoint in self.get_publishers_info_by_topic(subscription.topic_name)
        ]

    def latch(self, index: int) -> None:
        """Receive what the publishers of an input keep, too; those that keep nothing have the other subscription."""
        assert self.application
        subscription = self._inputs[index]
        events = SubscriptionEventCallbacks(use_default_callbacks=False)
        profile = interface.profile_of(self.application.parameters.latched_quality())
        take = self._taker(index, latched=True)
        self._latched[index] = self.create_subscription(
            subscription.msg_type, subscription.topic_name, take, profile, event_callbacks=events
        )

    def rivals(self) -> Sequence[str] | None:
        """The nodes of other publishers on our topics with the feed-forward."""
        if time.monotonic_ns() - self._made_ns < DISCOVERY_NS:
            return None
        assert self.application
        names: list[str] = []
        for output, topic in enumerate(self.application.outputs):
            name = self.resolve_topic_name(_relative_name(topic))
            if topic.name in TORQUES and self.count_publishers(name) > (output in self._outputs):
                nodes = [_node_of(endpoint) for endpoint in self.get_publishers_info_by_topic(name)]
                if output in self._outputs and self.get_fully_qualified_name() in nodes:
                    nodes.remove(self.get_fully_qualified_name())
                names += [f"{node or NAMELESS} on {name}" for node in nodes]
        return names

    def open_outputs(self) -> None:
        """Open the topics below the node's own name, if they are not open yet."""
        last_open = set(self._outputs)
        self._open(is_shared=False)
        for output in self._outputs.keys() - last_open:
            self._outputs[output].on_activate(None)

    def record(self, other_inputs: Sequence[InputTopic]) -> Sequence[str | None]:
        """Record every message, including those of other topics."""
        assert self.application
        self._recording = True
        texts = [interface.type_text(topic.type) for topic in (*self.application.inputs, *other_inputs)]
        for index, topic in enumerate(other_inputs, len(self.application.inputs)):
            if texts[index] is not None:
                kind = interface.installed_type(topic.type, topic.name)
                take = partial(self._keep, index)
                self._record_only.append(self.create_subscription(kind, topic.name, take, self._input_profile, raw=True))
        return texts

    def topic_name(self, name: str) -> str:
        """The full name of a topic, remapped."""
        return str(self.resolve_topic_name(name))

    def log(self, level: Level, text: str) -> None:
        """Write to the log of the node."""
        logger = self.get_logger()
        if level is Level.OK:
            logger.info(text)
        elif level is Level.ERROR:
            logger.error(text)
        else:
            logger.warning(text)

    # Called by ROS

    def _taker(self, index: int, latched: bool) -> Callable[[Any, dict[str, int]], None]:
        def take(message: Any, info: dict[str, int]) -> None:
            self._group.serves = False
            if self.application:
                self._inbox.put(index, (message, info, latched))
                self._collect()

        return take

    def _tick(self) -> None:
        if self.application and not self._group.waits_for_inputs:
            self._collect()
        self._group.serves = True
        self._tick_now()

    def _tick_now(self) -> None:
        if self.application:
            self._next_tick = time.monotonic_ns() + int(self.application.period_s * SECOND_NS)
            self.application.tick()

    def _tick_if_due(self) -> None:
        if time.monotonic_ns() >= self._next_tick:
            self._tick_now()

    def _collect(self) -> None:
        """Take the messages that have come, and hand them over."""
        assert self.application
        self._inbox.collect()
        self._inbox.work_off(self._tick_if_due, collecting=not self.application.parameters.sim_time)

    def _fetch(self, index: int) -> Iterator[Taken]:
        """Take the messages that wait at an input."""
        if latched := self._latched.get(index):
            yield from ((*message, True) for message in _waiting_messages(latched))
        yield from ((*message, False) for message in _waiting_messages(self._inputs[index]))

    def _deliver(self, index: int, message: Taken, arrival: Arrival) -> None:
        if self.application:
            content, info, latched = message
            raw = self.application.guard("recording", serialize_message, content) if self._recording else None
            is_mixed = self._inputs[index].get_publisher_count() > 1  # now: rclpy does not tell who sent a message
            origin = Sent(info["source_timestamp"], latched=latched, is_mixed=is_mixed)
            self.application.messages.receive(index, content, origin, arrival, raw)

    def _keep(self, index: int, raw: bytes) -> None:
        if self.application:
            self.application.messages.keep(index, raw)

    def _wait_or_collect(self, application: Application) -> None:
        """Wait for messages where they trigger outputs, or where fast simulated time stamps their arrival.

        Elsewhere each tick collects them. Outputs at a fixed rate change at a tick only, so nothing is lost. rclpy, in which
        waiting for a message is half of all work, then waits half as often.
        """
        rate_hz = application.parameters.number("output_rate_hz")
        self._group.waits_for_inputs = rate_hz < COLLECTED_FROM_HZ or application.parameters.sim_time

    def _server(self, service: Callable[[], str]) -> Callable[[Any, Any], Any]:
        def serve(_request: Any, response: Any) -> Any:
            try:
                response.message, response.success = service(), True
            except InputError as error:
                response.message, response.success = str(error), False
            except Exception as error:  # the caller needs an answer
                response.message, response.success = f"a bug: {type(error).__name__}: {error}", False
            return response

        return serve

    def _reporter(self, peer: str) -> Callable[[Any], None]:
        def report(event: Any) -> None:
            policy = str(event.last_policy_kind).rpartition(".")[2].lower()
            self.get_logger().warning(f"{peer} does not connect: its quality of service is incompatible in {policy}")

        return report

    def log_warning(self, text: str) -> None:
        """Write a warning to the log, if there is a text."""
        if text:
            self.get_logger().warning(text)

    def _check(self, changes: list[RosParameter]) -> Any:
        check = self.application.checked_change if self.application else interface.check_values
        return interface.check_result(check, interface.known_values(changes))

    def _apply(self, changes: list[RosParameter]) -> None:
        own_changes = interface.known_values(changes)
        if self.application and own_changes:
            self.application.change(own_changes)
            self._wait_or_collect(self.application)
            period_ns = int(self.application.period_s * SECOND_NS)
            if self._ticker.timer_period_ns != period_ns:
                self._ticker.timer_period_ns = period_ns


def _with_answer(change_state: Callable[[Any, Any], Any]) -> Callable[[Any, Any], Any]:
    """The service, refusing a transition that the present state does not have: rclpy would raise, and never answer."""

    def serve(request: Any, response: Any) -> Any:
        try:
            return change_state(request, response)
        except rclpy_implementation.RCLError:  # rcl has logged it
            response.success = False
            return response

    return serve


def _relative_name(topic: OutputTopic) -> str:
    return topic.name if topic.shared else f"~/{topic.name}"


def _node_of(endpoint: Any) -> str:
    """Full name of the node of an endpoint; empty where none announces it."""
    return "" if endpoint.node_name == UNKNOWN else f"{endpoint.node_namespace.rstrip('/')}/{endpoint.node_name}"


def _keeps_last(profile: QoSProfile) -> bool:
    """Whether a publisher keeps messages for those who join later."""
    return bool(profile.durability == DurabilityPolicy.TRANSIENT_LOCAL and profile.reliability == ReliabilityPolicy.RELIABLE)


def _waiting_messages(subscription: Any) -> Iterator[tuple[Any, dict[str, int]]]:
    """Take the waiting messages of a subscription."""
    with subscription.handle:
        for _ in range(MOST_COLLECTED):
            message = subscription.handle.take_message(subscription.msg_type, subscription.raw)
            if message is None:
                return
            yield message
