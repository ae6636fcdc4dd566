// Copyright the trackres_ros authors
// SPDX-License-Identifier: Apache-2.0

// A control loop with the exported step in its process: prints for each period the time from the speed to the torque [us].
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <thread>
#include <vector>

#include "trackres_feedforward/in_process.hpp"

int main(int count, char ** words)
{
  const long steps = count > 1 ? std::atol(words[1]) : 10000;
  const auto period = std::chrono::milliseconds(1);
  trackres_feedforward::InProcess step;
  std::vector<double> took(static_cast<std::size_t>(steps));
  double torque = 0.0;
  auto next = std::chrono::steady_clock::now();
  for (long n = 0; n < steps; ++n) {
    next += period;
    std::this_thread::sleep_until(next);
    const auto begin = std::chrono::steady_clock::now();
    torque = step.torque(8.0 + std::sin(0.001 * static_cast<double>(n)), 0.001, true);
    took[static_cast<std::size_t>(n)] = std::chrono::duration<double, std::micro>(std::chrono::steady_clock::now() - begin).count();
  }
  for (const double each : took) {
    std::printf("%.3f\n", each);
  }
  return torque > 0.0 ? 0 : 1;  // it drove: there is a torque
}
