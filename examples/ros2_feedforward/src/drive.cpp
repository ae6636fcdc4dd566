// Copyright the trackres_ros authors
// SPDX-License-Identifier: Apache-2.0

// A drive controller as a plain rclcpp node: it takes ~/estimate, and publishes on ~/added_torque what it adds to its own demand.

#include <chrono>
#include <memory>

#include "control_msgs/msg/dynamic_interface_group_values.hpp"
#include "rclcpp/rclcpp.hpp"
#include "std_msgs/msg/float64.hpp"

#include "trackres_feedforward/feedforward.hpp"

using Estimate = control_msgs::msg::DynamicInterfaceGroupValues;

class Drive : public rclcpp::Node
{
public:
  Drive()
  : Node("drive")
  {
    // The node offers 0.2 s (output_deadline_s): who asks for more than is offered is never connected. A deadline tells of a node
    // that hangs; of one that has ended it may not, which the age of the stamp does.
    const auto quality = rclcpp::QoS(1).deadline(std::chrono::milliseconds(200));
    rclcpp::SubscriptionOptions options;
    options.event_callbacks.deadline_callback = [this](rclcpp::QOSDeadlineRequestedInfo & missed) {
        RCLCPP_WARN(get_logger(), "the estimate does not come: deadline missed %d times", missed.total_count);
      };
    estimates_ = create_subscription<Estimate>(
      "trackres/estimate", quality,
      [this](const Estimate & message) {trackres_feedforward::read(message, sample_);}, options);
    added_ = create_publisher<std_msgs::msg::Float64>("~/added_torque", 10);
    timer_ = create_wall_timer(std::chrono::milliseconds(20), [this]() {step();});
    last_ = now();
  }

private:
  void step()
  {
    const rclcpp::Time time = now();
    std_msgs::msg::Float64 added;
    added.data = feedforward_.torque(sample_, time.seconds(), (time - last_).seconds());
    last_ = time;
    added_->publish(added);
  }

  trackres_feedforward::Sample sample_;
  trackres_feedforward::Feedforward feedforward_;
  rclcpp::Time last_;
  rclcpp::Subscription<Estimate>::SharedPtr estimates_;
  rclcpp::Publisher<std_msgs::msg::Float64>::SharedPtr added_;
  rclcpp::TimerBase::SharedPtr timer_;
};

int main(int argc, char ** argv)
{
  rclcpp::init(argc, argv);
  rclcpp::spin(std::make_shared<Drive>());
  rclcpp::shutdown();
  return 0;
}
