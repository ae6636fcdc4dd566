// Copyright the trackres_ros authors
// SPDX-License-Identifier: Apache-2.0

// The exported step of a vehicle (`trackres export c`) in the controller's own process, under the same rules as the topic.
// Nothing here allocates, locks or throws: `torque` may be called in a real-time loop.

#ifndef TRACKRES_FEEDFORWARD__IN_PROCESS_HPP_
#define TRACKRES_FEEDFORWARD__IN_PROCESS_HPP_

#include "trackres.h"
#include "trackres_feedforward/feedforward.hpp"

namespace trackres_feedforward
{

class InProcess
{
public:
  InProcess()
  {
    reset();
  }
  explicit InProcess(const Limits & limits)
  : feedforward_(limits)
  {
    reset();
  }

  /// Torque at the sprockets [Nm], `elapsed_s` after the last call, with a speed [m/s], or NAN where none came.
  double torque(double speed_mps, double elapsed_s, bool enabled)
  {
    trackres_inputs inputs;
    trackres_no_inputs(&inputs);
    inputs.speed_mps = static_cast<trackres_real>(speed_mps);
    inputs.enable = static_cast<trackres_real>(enabled ? 1.0 : 0.0);
    if (trackres_step(&state_, &inputs, static_cast<trackres_real>(elapsed_s), &outputs_) >= 0) {
      sample_.torque_nm = static_cast<double>(outputs_.feedforward_torque_nm);
      sample_.std_nm = static_cast<double>(outputs_.resistance_std_nm);
      sample_.level = outputs_.level;
      ++sample_.count;
    }  // else nothing has come: a step that refuses its time, or its state
    return feedforward_.torque(sample_, 0.0, elapsed_s);
  }

  /// What the last step gave: resistance, temperatures, standard deviation, level and reasons.
  const trackres_outputs & outputs() const {return outputs_;}

  /// Begin anew: belts at the ambient temperature, no speed yet, torque zero.
  void reset()
  {
    trackres_init(&state_);
    feedforward_.reset();
    outputs_ = trackres_outputs{};
    outputs_.level = TRACKRES_STALE;
  }

private:
  trackres_state state_;
  trackres_outputs outputs_;
  Feedforward feedforward_;
  Sample sample_{0.0};  // stamped with the time that it is asked for: what the step gives is of now
};

}  // namespace trackres_feedforward

#endif  // TRACKRES_FEEDFORWARD__IN_PROCESS_HPP_
