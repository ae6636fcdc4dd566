// Copyright the trackres_ros authors
// SPDX-License-Identifier: Apache-2.0

// A controller of ros2_control that computes the feed-forward in each update, with the exported step of a vehicle.
//
// Parameters:
//   vehicle                  name of the exported vehicle; another one is refused; empty accepts any
//   joints                   driven sprockets; each gets an equal share of the vehicle's torque on `<joint>/effort`
//   speed, speed_scale       state interfaces whose mean is the speed, and the metres per second of one unit (rad/s: the radius)
//   ramp_nm_per_s, bound_nm  limits of the torque
//   enable                   may change at any time
//
// ~/estimate is the node's message of this name, with the inputs of the step and the added torque.

#include <atomic>
#include <cmath>
#include <memory>
#include <string>
#include <vector>

#include "control_msgs/msg/dynamic_interface_group_values.hpp"
#include "controller_interface/controller_interface.hpp"
#include "hardware_interface/types/hardware_interface_type_values.hpp"
#include "pluginlib/class_list_macros.hpp"
#include "realtime_tools/realtime_publisher.hpp"

#include "trackres_feedforward/in_process.hpp"

namespace trackres_feedforward
{

using Estimate = control_msgs::msg::DynamicInterfaceGroupValues;
using controller_interface::CallbackReturn;
using controller_interface::return_type;
using controller_interface::interface_configuration_type;
using hardware_interface::HW_IF_EFFORT;

class InProcessController : public controller_interface::ControllerInterface
{
public:
  CallbackReturn on_init() override
  {
    auto_declare<std::string>("vehicle", "");
    auto_declare<std::vector<std::string>>("joints", {});
    auto_declare<std::vector<std::string>>("speed", {});
    auto_declare<double>("speed_scale", 1.0);
    auto_declare<double>("ramp_nm_per_s", limits_.ramp_nm_per_s);
    auto_declare<double>("bound_nm", limits_.bound_nm);
    enabled_ = auto_declare<bool>("enable", true);
    on_enable_ = get_node()->add_post_set_parameters_callback(
      [this](const std::vector<rclcpp::Parameter> & changed) {
        for (const auto & one : changed) {
          if (one.get_name() == "enable") {
            enabled_ = one.as_bool();
          }
        }
      });
    return CallbackReturn::SUCCESS;
  }

  CallbackReturn on_configure(const rclcpp_lifecycle::State &) override
  {
    const std::string vehicle = get_node()->get_parameter("vehicle").as_string();
    if (!vehicle.empty() && vehicle != TRACKRES_VEHICLE) {
      RCLCPP_ERROR(get_node()->get_logger(), "parameter vehicle is '%s', but the export is of '%s': build with its export", vehicle.c_str(), TRACKRES_VEHICLE);
      return CallbackReturn::ERROR;
    }
    joints_ = get_node()->get_parameter("joints").as_string_array();
    speeds_ = get_node()->get_parameter("speed").as_string_array();
    speed_scale_ = get_node()->get_parameter("speed_scale").as_double();
    limits_.ramp_nm_per_s = get_node()->get_parameter("ramp_nm_per_s").as_double();
    limits_.bound_nm = get_node()->get_parameter("bound_nm").as_double();
    if (joints_.empty() || speeds_.empty()) {
      RCLCPP_ERROR(get_node()->get_logger(), "parameters joints and speed: name the driven sprockets and the state interfaces of the speed");
      return CallbackReturn::ERROR;
    }
    if (!(std::isfinite(speed_scale_) && speed_scale_ != 0.0 && limits_.ramp_nm_per_s > 0.0 && limits_.bound_nm >= 0.0)) {
      RCLCPP_ERROR(get_node()->get_logger(), "parameters speed_scale, ramp_nm_per_s, bound_nm: give a scale other than 0, a positive ramp and a bound of at least 0");
      return CallbackReturn::ERROR;
    }
    message_.interface_groups = {"vehicle"};
    message_.interface_values.resize(1);
    message_.interface_values[0].interface_names = {
      "feedforward_torque_nm", "resistance_std_nm", "level", "speed_mps", "elapsed_s", "enable", "added_torque_nm"};
    message_.interface_values[0].values.resize(message_.interface_values[0].interface_names.size());
    estimate_ = std::make_unique<realtime_tools::RealtimePublisher<Estimate>>(
      get_node()->create_publisher<Estimate>("~/estimate", rclcpp::SystemDefaultsQoS()));
    return CallbackReturn::SUCCESS;
  }

  CallbackReturn on_activate(const rclcpp_lifecycle::State &) override
  {
    step_ = InProcess(limits_);
    return CallbackReturn::SUCCESS;
  }

  CallbackReturn on_deactivate(const rclcpp_lifecycle::State &) override
  {
    return command(0.0) ? CallbackReturn::SUCCESS : CallbackReturn::ERROR;
  }

  controller_interface::InterfaceConfiguration command_interface_configuration() const override
  {
    std::vector<std::string> names;
    for (const auto & joint : joints_) {
      names.push_back(joint + "/" + HW_IF_EFFORT);
    }
    return {interface_configuration_type::INDIVIDUAL, names};
  }

  controller_interface::InterfaceConfiguration state_interface_configuration() const override
  {
    return {interface_configuration_type::INDIVIDUAL, speeds_};
  }

  return_type update(const rclcpp::Time & time, const rclcpp::Duration & period) override
  {
    double sum = 0.0;
    for (const auto & speed : state_interfaces_) {
      sum += speed.get_optional().value_or(std::nan(""));
    }
    const double speed_mps = speed_scale_ * sum / static_cast<double>(state_interfaces_.size());
    const bool enabled = enabled_;
    const double torque = step_.torque(speed_mps, period.seconds(), enabled);
    const trackres_outputs & outputs = step_.outputs();
    message_.header.stamp = time;
    auto value = message_.interface_values[0].values.begin();
    for (const double one : {static_cast<double>(outputs.feedforward_torque_nm), static_cast<double>(outputs.resistance_std_nm),
        static_cast<double>(outputs.level), speed_mps, period.seconds(), enabled ? 1.0 : 0.0, torque})
    {
      *value++ = one;
    }
    estimate_->try_publish(message_);  // skipped while the publisher's thread is busy
    return command(torque) ? return_type::OK : return_type::ERROR;
  }

private:
  /// Divide a torque among the sprockets; false if an interface refuses it.
  bool command(double torque)
  {
    const double share = torque / static_cast<double>(joints_.size());
    bool written = true;
    for (auto & one : command_interfaces_) {
      written = one.set_value(share) && written;
    }
    return written;
  }

  std::vector<std::string> joints_;
  std::vector<std::string> speeds_;
  double speed_scale_ = 1.0;
  Limits limits_;
  InProcess step_;
  std::atomic<bool> enabled_{true};
  Estimate message_;
  std::unique_ptr<realtime_tools::RealtimePublisher<Estimate>> estimate_;
  rclcpp::node_interfaces::PostSetParametersCallbackHandle::SharedPtr on_enable_;
};

}  // namespace trackres_feedforward

PLUGINLIB_EXPORT_CLASS(trackres_feedforward::InProcessController, controller_interface::ControllerInterface)
