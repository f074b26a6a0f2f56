// A phone's profile of the computer that the program runs on: stories of the emulated phone are tracked there, their
// stages and slices timed, and the figures of the kinds of work chosen so that the work meter says what the clock said.
#pragma once

#include <array>
#include <cstddef>
#include <span>
#include <string>
#include <vector>

#include "sim_phone/laboratory/budget.h"

namespace pptam::laboratory {

// All stages or slices of one kind: time of this thread, and units charged.
struct SpanWork {
  double ns = 0;
  std::array<double, kWorkKinds> units = {};
};
using SpanWorks = std::array<SpanWork, kSpans>;  // by Span

struct Calibration {
  PhoneProfile processor;
  SpanWorks measured;
  double modelled_ns(Span span) const;  // by the processor
};

// The figure of each kind is ARMv6's times a factor: all begin with that by which the whole differs, and each is then
// moved by the mean, over the spans in which it is charged, of what the span still differs by. What a single span
// cannot tell apart keeps its ratio.
PhoneProfile fit_processor(const SpanWorks& measured, double clock_mhz);

// Tracks the options' stories several times over; the least time of each stage counts. Throws InputError, also when it
// was interrupted.
Calibration calibrate(const BudgetOptions& options, double clock_mhz);

// This computer's clock rate, MHz; 1000 where it is not told: only its ratio to the cycles matters.
double clock_rate_mhz();

// A profile with that processor, and camera, capture and display as of `like`; sealed (platform/outputs.h).
std::string profile_text(const Phone& like, const Calibration& calibration);
bool is_profile(std::span<const std::byte> content);  // such a text, as it was written

void print_calibration(const Calibration& calibration);

}  // namespace pptam::laboratory
