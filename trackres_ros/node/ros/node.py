# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The live node on ROS 2: a lifecycle node that lends its middleware to the application."""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any

from rclpy.callback_groups import CallbackGroup
from rclpy.clock import Clock, ClockType, JumpThreshold
from rclpy.duration import Duration
from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.parameter import Parameter as RosParameter
from rclpy.qos import QoSCompatibility, QoSProfile, ReliabilityPolicy, qos_check_compatible
from rclpy.serialization import serialize_message
from rclpy.subscription import Subscription
from std_srvs.srv import Trigger

from trackres_ros.errors import InputError
from trackres_ros.node.application import Application
from trackres_ros.node.edge import Level, Peer, Reasons, Status
from trackres_ros.node.endpoints import InputTopic, Quality, input_quality, output_quality
from trackres_ros.node.inbox import Arrival, Inbox
from trackres_ros.node.parameters import Parameters, make_parameters
from trackres_ros.node.ros import parameters as ros_parameters
from trackres_ros.node.ros.messages import (
    Fill,
    PreparedEstimate,
    diagnostic_array,
    input_type,
    installed_type,
    prepared,
    type_text,
)
from trackres_ros.output.topics import DEFAULT_NODE, ESTIMATE_TOPIC
from trackres_ros.units import SECOND_NS

COLLECTED_FROM_HZ = 20.0  # of the outputs: the inputs' queues hold what comes between two of them, at 1 kHz too

MOST_COLLECTED = 1000  # of a topic at a time

Taken = tuple[Any, dict[str, int]]
"""A message and what the middleware says about it."""


class Gate(CallbackGroup):  # type: ignore[misc]
    """What is behind it runs while it is open; with one thread an executor need know no more."""

    def __init__(self) -> None:
        super().__init__()
        self.open = True

    def can_execute(self, entity: Any) -> bool:  # noqa: ARG002 - alike for all
        """Whether the executor is to wait for it, or run it."""
        return self.open

    def beginning_execution(self, entity: Any) -> bool:  # noqa: ARG002
        """Nothing else runs meanwhile."""
        return True

    def ending_execution(self, entity: Any) -> None:
        """Nothing is held."""


class Counter(Gate):
    """Services and events wait here while messages pass, and are served after the next tick.

    rclpy builds its wait set anew for each message, out of every entity that may run: with dozens of services and event
    handlers in it that takes longer than the estimate itself. The one subscription here is rclpy's own, of /clock, and passes
    with the messages: it is their time.
    """

    def can_execute(self, entity: Any) -> bool:
        """Whether it is open, or need not be."""
        return self.open or isinstance(entity, Subscription)


class EstimatorNode(LifecycleNode):  # type: ignore[misc]
    """The node; see docs/node.md.

    Parameters
    ----------
    values
        Values that stand in for the defaults of the parameters.
    arguments
        Of `rclpy.node.Node`: namespace, context, cli_args, parameter_overrides...
    """

    def __init__(self, values: Parameters | None = None, node: str = DEFAULT_NODE, **arguments: Any) -> None:
        self._counter = Counter()
        self.application: Application | None = None
        self.failure = ""
        self.refused: InputError | None = None  # what a transition refused last
        super().__init__(node, **arguments)
        self.add_on_set_parameters_callback(self._check)
        ros_parameters.declare(self, values or make_parameters({}))
        self.add_post_set_parameters_callback(self._apply)

    @property
    def default_callback_group(self) -> CallbackGroup:
        """Where services and events wait."""
        return self._counter

    # Lifecycle

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Make the application and connect it."""
        return self._transition(self._configure, state)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Begin to publish."""
        return self._transition(self._activate, state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stop publishing; the estimate goes on."""
        return self._transition(self._deactivate, state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Save the state and let go of everything."""
        return self._transition(lambda _: self.release(), state)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Save the state and let go of everything."""
        return self._transition(lambda _: self.release(), state)

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Let go of everything, so that it can be configured anew."""
        return self._transition(lambda _: self.release(), state)

    def _transition(self, step: Callable[[LifecycleState], None], state: LifecycleState) -> TransitionCallbackReturn:
        """Do a step; rclpy would swallow an exception, so it is logged and told."""
        try:
            step(state)
        except InputError as error:
            self.failure, self.refused = str(error), error
            self.get_logger().error(self.failure)
            self.release()
            return TransitionCallbackReturn.FAILURE
        except Exception as error:
            self.failure = f"{type(error).__name__}: {error}"
            self.get_logger().error("".join(traceback.format_exception(error)))
            return TransitionCallbackReturn.ERROR
        return TransitionCallbackReturn.SUCCESS

    def _configure(self, _state: LifecycleState) -> None:
        parameters = ros_parameters.read(self)
        self._frame_id = parameters.text("frame_id")
        application = Application(parameters, self, self.get_name(), self.get_namespace())
        kinds = [input_type(given, application.topics.origin) for given in application.inputs]
        self.application = application
        self._fills: list[Fill | None] = []
        self._outputs: list[Any] = []  # None where the type of a topic is not installed
        self._estimate = self._prepared_estimate()
        for topic in application.outputs:
            if topic is ESTIMATE_TOPIC and self._estimate is None:
                self._fills.append(None)
                self._outputs.append(None)
                continue
            name = topic.name if topic.name.startswith("/") else f"~/{topic.name}"
            profile = _profile(output_quality(parameters, topic))
            events = PublisherEventCallbacks(
                incompatible_qos=self._reporter(f"a subscriber of {name}"), use_default_callbacks=False
            )
            self._fills.append(None if topic.kind in ("status", "estimate") else prepared(topic, self._frame_id))
            kind = installed_type(topic.type, f"topic {name}")
            self._outputs.append(self.create_lifecycle_publisher(kind, name, profile, event_callbacks=events))
        self._input_profile = _profile(input_quality(parameters))
        self._gate = Gate()
        self._inputs = [
            self.create_subscription(
                kind,
                given.name,
                self._taker(index),
                self._input_profile,
                callback_group=self._gate,
                event_callbacks=SubscriptionEventCallbacks(
                    incompatible_qos=self._reporter(f"a publisher of {given.name}"), use_default_callbacks=False
                ),
            )
            for index, (given, kind) in enumerate(zip(application.inputs, kinds, strict=True))
        ]
        self._recording = False
        self._kept: list[Any] = []
        self._inbox = Inbox(
            [application.guard.taking(f"reading {given.topic_name}", partial(_come, given)) for given in self._inputs],
            self._hand,
            application.arrival,
            application.dropped,
            int(parameters.number("input_depth")),
        )
        self._next_tick = 0
        self._offered = [
            self.create_service(Trigger, "~/reset", self._server(application.reset)),
            self.create_service(Trigger, "~/reset_learning", self._server(application.reset_learning)),
            self.create_service(Trigger, "~/save_state", self._server(application.save_state)),
        ]
        back = Duration(nanoseconds=-int(application.estimator.settings.clock_jump_s * SECOND_NS))
        self._jumps = self.get_clock().create_jump_callback(
            JumpThreshold(min_forward=None, min_backward=back, on_clock_change=False),
            post_callback=lambda _: application.guard.essential("the clock", application.time_went_back),
        )
        self._steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._ticker = self.create_timer(application.period_s, self._tick, callback_group=Gate(), clock=self._steady)
        self._wait_or_collect(application)
        self.get_logger().info(f"{application.vehicle.title}; {application.began_with}")

    def _activate(self, state: LifecycleState) -> None:
        super().on_activate(state)
        assert self.application
        self.application.activate()

    def _deactivate(self, state: LifecycleState) -> None:
        assert self.application
        self.application.deactivate()
        super().on_deactivate(state)

    def release(self) -> None:
        """Save the state and destroy what `on_configure` made."""
        application, self.application = self.application, None
        if application is None:
            return
        self.get_logger().info(application.close())
        self._jumps.unregister()
        self.destroy_timer(self._ticker)
        for given in (*self._inputs, *self._kept):
            self.destroy_subscription(given)
        for output in filter(None, self._outputs):
            self.destroy_lifecycle_publisher(output)
        for service in self._offered:
            self.destroy_service(service)

    # What the application asks of its edge

    def _prepared_estimate(self) -> PreparedEstimate | None:
        """None where its type is not installed, or is another: it alone is not among the common interfaces."""
        try:
            return PreparedEstimate(self._frame_id)
        except (InputError, AttributeError, AssertionError, TypeError) as error:  # not there, or of another version
            self.get_logger().warning(f"~/{ESTIMATE_TOPIC.name} is not published, all other topics are: {error}")
            return None

    def now_ns(self) -> int:
        """The node's time, simulated where use_sim_time is set."""
        return int(self.get_clock().now().nanoseconds)

    def publish(self, output: int, stamp_ns: int, values: Sequence[float]) -> None:
        """Publish a message of numbers."""
        fill = self._fills[output]
        assert fill
        self._outputs[output].publish(fill(stamp_ns, values))

    def publish_estimate(self, output: int, stamp_ns: int, values: Sequence[float], reasons: Reasons) -> None:
        """Publish the message of `topics.ESTIMATE_TOPIC`, where its type is installed."""
        if self._estimate is not None:
            self._outputs[output].publish(self._estimate.filled(stamp_ns, values, reasons))

    def publish_status(self, output: int, stamp_ns: int, statuses: Sequence[Status]) -> None:
        """Publish a DiagnosticArray."""
        self._outputs[output].publish(diagnostic_array(stamp_ns, statuses, self._frame_id))

    def peers(self, index: int) -> Sequence[Peer]:
        """The publishers on the topic of an input."""
        return [
            Peer(
                found.topic_type,
                qos_check_compatible(found.qos_profile, self._input_profile)[0] != QoSCompatibility.ERROR,
            )
            for found in self.get_publishers_info_by_topic(self._inputs[index].topic_name)
        ]

    def record(self, others: Sequence[InputTopic]) -> Sequence[str | None]:
        """Have every message kept, of other topics besides."""
        assert self.application
        self._recording = True
        texts = [type_text(given.type) for given in (*self.application.inputs, *others)]
        for index, given in enumerate(others, len(self.application.inputs)):
            if texts[index] is not None:
                kind = installed_type(given.type, given.name)
                take = partial(self._keep, index)
                self._kept.append(
                    self.create_subscription(kind, given.name, take, self._input_profile, callback_group=Gate(), raw=True)
                )
        return texts

    def log(self, level: Level, text: str) -> None:
        """Say something in the log of the node."""
        logger = self.get_logger()
        if level is Level.OK:
            logger.info(text)
        elif level is Level.ERROR:
            logger.error(text)
        else:
            logger.warning(text)

    # What ROS calls

    def _taker(self, index: int) -> Callable[[Any, dict[str, int]], None]:
        def take(message: Any, about: dict[str, int]) -> None:
            self._counter.open = False
            if self.application:
                self._inbox.put(index, (message, about))
                self._collect()

        return take

    def _tick(self) -> None:
        if self.application and not self._gate.open:
            self._collect()
        self._counter.open = True
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

    def _hand(self, index: int, message: Taken, arrived: Arrival) -> None:
        if self.application:
            if self._recording:
                self.application.guard("recording", self._record, self.application, index, message[0], arrived)
            self.application.receive(index, message[0], message[1]["source_timestamp"], arrived)

    def _record(self, application: Application, index: int, message: object, arrived: Arrival) -> None:
        application.keep(index, serialize_message(message), arrived)

    def _keep(self, index: int, raw: bytes) -> None:
        if self.application:
            self.application.keep(index, raw, self.application.arrival())

    def _wait_or_collect(self, application: Application) -> None:
        """Wait for messages where they are answered, or where simulated time stamps their arrival and runs fast.

        Elsewhere each tick takes what has come. Outputs at a fixed rate change at a tick only, so nothing is lost by that, and
        rclpy, for which waiting for one message is half the work of it all, waits half as often.
        """
        rate_hz = application.parameters.number("output_rate_hz")
        self._gate.open = rate_hz < COLLECTED_FROM_HZ or application.parameters.sim_time

    def _server(self, what: Callable[[], str]) -> Callable[[Any, Any], Any]:
        def serve(_request: Any, response: Any) -> Any:
            try:
                response.message, response.success = what(), True
            except InputError as error:
                response.message, response.success = str(error), False
            except Exception as error:  # who asked is to have an answer
                response.message, response.success = f"a fault of this program: {type(error).__name__}: {error}", False
            return response

        return serve

    def _reporter(self, who: str) -> Callable[[Any], None]:
        def report(event: Any) -> None:
            policy = str(event.last_policy_kind).rpartition(".")[2].lower()
            self.get_logger().warning(f"{who} does not connect: its quality of service does not fit in {policy}")

        return report

    def _check(self, changes: list[RosParameter]) -> Any:
        check = self.application.checked_change if self.application else ros_parameters.check_values
        return ros_parameters.verdict(check, ros_parameters.named(changes))

    def _apply(self, changes: list[RosParameter]) -> None:
        if self.application:
            self.application.change(ros_parameters.named(changes))
            self._wait_or_collect(self.application)
            period_ns = int(self.application.period_s * SECOND_NS)
            if self._ticker.timer_period_ns != period_ns:
                self._ticker.timer_period_ns = period_ns


def _come(given: Any) -> Iterator[Taken]:
    """Take what waits in a subscription."""
    with given.handle:
        for _ in range(MOST_COLLECTED):
            taken = given.handle.take_message(given.msg_type, given.raw)
            if taken is None:
                return
            yield taken


def _profile(quality: Quality) -> QoSProfile:
    """Quality of service as ROS 2 has it."""
    reliability = ReliabilityPolicy.RELIABLE if quality.reliable else ReliabilityPolicy.BEST_EFFORT
    profile = QoSProfile(depth=quality.depth, reliability=reliability)
    if quality.deadline_s > 0.0:
        profile.deadline = Duration(seconds=quality.deadline_s)
    return profile
