// Copyright the trackres_ros authors
// SPDX-License-Identifier: Apache-2.0

// What a controller in C++ does with ~/estimate: the rules of docs/node.md, without a middleware.
// Nothing here allocates, locks or throws once a message is read: `torque` may be called in a real-time loop.

#ifndef TRACKRES_FEEDFORWARD__FEEDFORWARD_HPP_
#define TRACKRES_FEEDFORWARD__FEEDFORWARD_HPP_

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>

namespace trackres_feedforward
{

constexpr double OK = 0.0;
constexpr double WARN = 1.0;
constexpr double STALE = 3.0;

/// What one message says.
struct Sample
{
  double stamp_s = -std::numeric_limits<double>::infinity();  // time of the state [s]
  double torque_nm = 0.0;                                      // at the sprockets, whole vehicle; positive drives forward
  double std_nm = std::numeric_limits<double>::infinity();     // standard deviation of the resistance
  double level = STALE;
  std::uint64_t count = 0;                                     // of messages: by it the controller sees that one has come
};

/// What the controller allows.
struct Limits
{
  double silence_s = 0.2;           // without a message, in the controller's own time: the node's output_deadline_s
  double oldest_s = 2.0;            // age of a stamp: by then the node has faded to zero, so what is older waited on its way
  double farthest_ahead_s = 0.05;   // of a stamp before this clock: more is another clock, of which no age can be told
  double ramp_nm_per_s = 5000.0;
  double bound_nm = 20000.0;
};

/// Read a control_msgs/msg/DynamicInterfaceGroupValues; false, and the sample as it was, where the message lacks something.
template<typename Message>
bool read(const Message & message, Sample & sample)
{
  const auto & groups = message.interface_groups;
  for (std::size_t g = 0; g < groups.size() && g < message.interface_values.size(); ++g) {
    if (groups[g] != "vehicle") {
      continue;
    }
    const auto & names = message.interface_values[g].interface_names;
    const auto & values = message.interface_values[g].values;
    Sample found;
    int count = 0;
    for (std::size_t i = 0; i < names.size() && i < values.size(); ++i) {
      if (names[i] == "feedforward_torque_nm") {
        found.torque_nm = values[i];
        ++count;
      } else if (names[i] == "resistance_std_nm") {
        found.std_nm = values[i];
        ++count;
      } else if (names[i] == "level") {
        found.level = values[i];
        ++count;
      }
    }
    if (count != 3) {
      return false;
    }
    found.count = sample.count + 1;
    found.stamp_s = message.header.stamp.sec + message.header.stamp.nanosec * 1e-9;
    sample = found;
    return true;
  }
  return false;
}

/// The torque to add to what the speed controller asks for.
class Feedforward
{
public:
  Feedforward() = default;
  explicit Feedforward(const Limits & limits)
  : limits_(limits) {}

  /// Torque at the sprockets [Nm], to be called in each control step, `elapsed_s` after the last one; it never jumps.
  ///
  /// It adds what comes, and goes to zero once nothing comes. A time that is none counts as the last one.
  double torque(const Sample & sample, double now_s, double elapsed_s)
  {
    period_s_ = std::isfinite(elapsed_s) && elapsed_s >= 0.0 ? elapsed_s : period_s_;
    silent_s_ = (sample.count != seen_ ? 0.0 : silent_s_) + period_s_;
    seen_ = sample.count;
    const double wanted =
      usable(sample, now_s) ? std::clamp(sample.torque_nm, -limits_.bound_nm, limits_.bound_nm) : 0.0;
    const double room = limits_.ramp_nm_per_s * std::min(period_s_, 0.1);
    used_ += std::clamp(wanted - used_, -room, room);
    return used_;
  }

  /// Begin from zero, and wait for a new message.
  void reset()
  {
    used_ = 0.0;
    silent_s_ = std::numeric_limits<double>::infinity();
  }

private:
  /// Whether a sample is added. STALE is no reason against it: the node fades the torque to zero by itself.
  bool usable(const Sample & sample, double now_s) const
  {
    const double age_s = now_s - sample.stamp_s;
    return silent_s_ <= limits_.silence_s && std::isfinite(sample.torque_nm) && age_s >= -limits_.farthest_ahead_s &&
           age_s <= limits_.oldest_s && (sample.level == OK || sample.level == WARN || sample.level == STALE);
  }

  Limits limits_;
  double used_ = 0.0;
  double period_s_ = 0.0;
  double silent_s_ = std::numeric_limits<double>::infinity();
  std::uint64_t seen_ = 0;
};

}  // namespace trackres_feedforward

#endif  // TRACKRES_FEEDFORWARD__FEEDFORWARD_HPP_
