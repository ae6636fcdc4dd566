// Copyright the trackres_ros authors
// SPDX-License-Identifier: Apache-2.0

// A chainable controller of ros2_control: the effort that the controller in front of it asks for, plus the feed-forward.
//
// Parameters: `joints`, the driven sprockets, among which the torque of the whole vehicle is divided; `estimate`, the topic.
// References and commands are `<joint>/effort`. Where nothing stands in front of it, references are 0. What it adds is published
// on ~/added_torque [Nm].

#include <cmath>
#include <memory>
#include <string>
#include <vector>

#include "control_msgs/msg/dynamic_interface_group_values.hpp"
#include "controller_interface/chainable_controller_interface.hpp"
#include "hardware_interface/types/hardware_interface_type_values.hpp"
#include "pluginlib/class_list_macros.hpp"
#include "realtime_tools/realtime_buffer.hpp"
#include "realtime_tools/realtime_publisher.hpp"
#include "std_msgs/msg/float64.hpp"

#include "trackres_feedforward/feedforward.hpp"

namespace trackres_feedforward
{

using Float64 = std_msgs::msg::Float64;
using Estimate = control_msgs::msg::DynamicInterfaceGroupValues;
using controller_interface::CallbackReturn;
using controller_interface::return_type;
using hardware_interface::HW_IF_EFFORT;

class FeedforwardController : public controller_interface::ChainableControllerInterface
{
public:
  CallbackReturn on_init() override
  {
    auto_declare<std::vector<std::string>>("joints", {});
    auto_declare<std::string>("estimate", "/trackres/estimate");
    return CallbackReturn::SUCCESS;
  }

  CallbackReturn on_configure(const rclcpp_lifecycle::State &) override
  {
    joints_ = get_node()->get_parameter("joints").as_string_array();
    if (joints_.empty()) {
      RCLCPP_ERROR(get_node()->get_logger(), "parameter joints: empty; give the names of the driven sprockets");
      return CallbackReturn::ERROR;
    }
    estimates_ = get_node()->create_subscription<Estimate>(
      get_node()->get_parameter("estimate").as_string(), rclcpp::QoS(1),
      [this](const Estimate & message) {
        if (read(message, received_)) {
          samples_.writeFromNonRT(received_);
        }
      });
    added_ = std::make_unique<realtime_tools::RealtimePublisher<Float64>>(
      get_node()->create_publisher<Float64>("~/added_torque", rclcpp::SystemDefaultsQoS()));
    return CallbackReturn::SUCCESS;
  }

  CallbackReturn on_activate(const rclcpp_lifecycle::State &) override
  {
    feedforward_.reset();
    asked_.assign(joints_.size(), 0.0);
    return CallbackReturn::SUCCESS;
  }

  controller_interface::InterfaceConfiguration command_interface_configuration() const override
  {
    std::vector<std::string> names;
    for (const auto & joint : joints_) {
      names.push_back(joint + "/" + HW_IF_EFFORT);
    }
    return {controller_interface::interface_configuration_type::INDIVIDUAL, names};
  }

  controller_interface::InterfaceConfiguration state_interface_configuration() const override
  {
    return {controller_interface::interface_configuration_type::NONE, {}};
  }

protected:
  std::vector<hardware_interface::CommandInterface::SharedPtr> on_export_reference_interfaces_list() override
  {
    asked_.assign(joints_.size(), 0.0);
    std::vector<hardware_interface::CommandInterface::SharedPtr> exported;
    for (std::size_t i = 0; i < joints_.size(); ++i) {
      exported.push_back(std::make_shared<hardware_interface::CommandInterface>(
          get_node()->get_name(), joints_[i] + "/" + HW_IF_EFFORT, &asked_[i]));
    }
    return exported;
  }

  return_type update_reference_from_subscribers(const rclcpp::Time &, const rclcpp::Duration &) override
  {
    return return_type::OK;  // nothing stands in front: the references stay 0
  }

  return_type update_and_write_commands(const rclcpp::Time & time, const rclcpp::Duration & period) override
  {
    const double share = 1.0 / static_cast<double>(joints_.size());
    const double torque = feedforward_.torque(*samples_.readFromRT(), time.seconds(), period.seconds());
    bool written = true;
    message_.data = torque;
    added_->try_publish(message_);  // where the thread that sends is busy, this one goes unheard
    for (std::size_t i = 0; i < joints_.size(); ++i) {
      const double asked = std::isfinite(asked_[i]) ? asked_[i] : 0.0;
      written = command_interfaces_[i].set_value(asked + share * torque) && written;
    }
    return written ? return_type::OK : return_type::ERROR;
  }

private:
  std::vector<std::string> joints_;
  std::vector<double> asked_;  // by what stands in front, of each joint
  Sample received_;
  realtime_tools::RealtimeBuffer<Sample> samples_{Sample{}};
  Feedforward feedforward_;
  Float64 message_;
  std::unique_ptr<realtime_tools::RealtimePublisher<Float64>> added_;
  rclcpp::Subscription<Estimate>::SharedPtr estimates_;
};

}  // namespace trackres_feedforward

PLUGINLIB_EXPORT_CLASS(
  trackres_feedforward::FeedforwardController, controller_interface::ChainableControllerInterface)
