// The fixed-point control against the same laws in float64, over random steps. Prints the largest differences; the
// sanitizers watch every operation.
//
// The observer runs free beside its twin. The loops have hysteresis and an integral, so their twins start every step
// from the fixed-point state.
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include "tiger/control/position_loop.h"
#include "tiger/control/pot_curve.h"
#include "tiger/control/rate_loop.h"
#include "tiger/control/stroke_observer.h"

using namespace tiger;

namespace {

uint64_t seed = 1;
double uniform() {
  seed = seed * 6364136223846793005ull + 1442695040888963407ull;
  return static_cast<double>(seed >> 11) * 0x1p-53;
}
double between(double low, double high) { return low + (high - low) * uniform(); }
double worst_of(double worst, double difference) {
  return fabs(difference) > worst ? fabs(difference) : worst;
}
double clip(double x, double limit) { return x > limit ? limit : x < -limit ? -limit : x; }

constexpr double kDecay = 0.8187307530779818;
constexpr double kShare = 1.0 - kDecay;
constexpr double kTravel = 1.0 - 5.0 * kShare;

struct ObserverTwin {
  double stroke = 0.0;
  double rate = 0.0;

  void predict(double drive) {
    stroke += rate + kTravel * (drive - rate);
    rate += kShare * (drive - rate);
  }
  void correct(double reading) {
    const double surprise = reading - (stroke - 0.67 * rate);
    stroke += surprise / 4.0;
    rate += surprise / 64.0;
  }
};

// Readings in sums of 16 conversions, the curve in float64.
struct CurveTwin {
  double points[5];
  double full;
  double stroke(double reading) const {
    int i = 0;
    while (i < 3 && reading >= points[i + 1]) ++i;
    return full / 4 * (i + (reading - points[i]) / (points[i + 1] - points[i]));
  }
};

void observer(long steps) {
  StrokeObserver fixed;
  ObserverTwin twin;
  double stroke = 35.0 * kUnitsPerMm, rate = 0.0;
  fixed.start(static_cast<int32_t>(stroke));
  twin.stroke = stroke;
  int16_t drive = 0;
  double worst_stroke = 0.0, worst_rate = 0.0;
  for (long n = 0; n < steps; ++n) {
    if (uniform() < 0.02) {
      drive = static_cast<int16_t>(between(-9400, 9400));
      if (uniform() < 0.3) drive = 0;
      if (stroke > 65.0 * kUnitsPerMm) drive = -9400;
      if (stroke < 5.0 * kUnitsPerMm) drive = 9400;
    }
    stroke += rate + kTravel * (drive - rate);
    rate += kShare * (drive - rate);
    const int32_t reading = static_cast<int32_t>(lrint(stroke - 0.67 * rate + between(-4000, 4000)));
    fixed.predict(drive);
    fixed.correct(fixed.surprise(reading));
    twin.predict(drive);
    twin.correct(reading);
    worst_stroke = worst_of(worst_stroke, fixed.stroke() - twin.stroke);
    worst_rate = worst_of(worst_rate, fixed.rate() - twin.rate);
  }
  printf("observer_stroke_counts %.4f\n", worst_stroke / kUnitsPerWireCount);
  printf("observer_rate_permille %.4f\n", worst_rate / 9.4);
}

void rate_loop(long steps) {
  RateLoop fixed;
  fixed.set_full_speed(9400);
  double worst_duty = 0.0, worst_integral = 0.0;
  for (long n = 0; n < steps; ++n) {
    if (uniform() < 0.01) fixed.rest(static_cast<int16_t>(between(-9400, 9400)));
    const double expected = fixed.expected(), integral = fixed.integral();
    const int16_t wish = static_cast<int16_t>(between(-14000, 14000));
    const int16_t rate = static_cast<int16_t>(clip(expected + between(-4000, 4000), 12000));
    const int16_t drive = fixed.step(wish, rate);

    const double target = clip(wish, 9400);
    const double lack = expected - rate - clip(expected - rate, 150);
    const double wanted = target + lack + integral / 32.0;
    const double twin_drive = clip(wanted, 9400);
    double twin_integral = clip(integral + lack, 3000.0 * 32.0);
    const double excess = wanted - twin_drive;
    if (excess > 0 && twin_integral > 0) twin_integral = fmax(twin_integral - 4.0 * excess, 0.0);
    if (excess < 0 && twin_integral < 0) twin_integral = fmin(twin_integral - 4.0 * excess, 0.0);

    worst_duty = worst_of(worst_duty, fixed.duty_permille(drive) - 1000.0 * twin_drive / 9400.0);
    worst_integral = worst_of(worst_integral, (fixed.integral() - twin_integral) / 32.0 / 9.4);
  }
  printf("rate_loop_duty_permille %.4f\n", worst_duty);
  printf("rate_loop_integral_permille %.4f\n", worst_integral);
}

void position_loop(long steps) {
  PositionLoop fixed;
  fixed.start(35 * kUnitsPerMm);
  double worst = 0.0;
  for (long n = 0; n < steps; ++n) {
    const int16_t rate = uniform() < 0.3 ? int16_t{0} : static_cast<int16_t>(between(-9400, 9400));
    const int16_t moved = fixed.advance(rate, 1 * kUnitsPerMm, 69 * kUnitsPerMm);
    const int32_t stop_point = fixed.reference() + static_cast<int32_t>(between(-50000, 50000));
    fixed.hold_leash(stop_point);
    const double error = fixed.reference() - stop_point;
    const int16_t target = fixed.step(moved, stop_point);
    const double push = fixed.correcting() ? error / 8.0 + (error > 0 ? 2000.0 : -2000.0) : 0.0;
    worst = worst_of(worst, (target - (moved + push)) / 9.4);
  }
  printf("position_loop_permille %.4f\n", worst);
}

void pot_curve(long steps) {
  double worst = 0.0;
  for (long n = 0; n < steps; ++n) {
    uint16_t points[5];
    double at = between(0, 3000);
    const uint16_t full = static_cast<uint16_t>(between(20000, 50000));
    CurveTwin twin;
    twin.full = full * 200.0;
    const bool falls = uniform() < 0.5;
    for (int i = 0; i < 5; ++i) {
      points[i] = static_cast<uint16_t>(at);
      twin.points[i] = points[i];
      at += between(2600, 3300);
    }
    if (points[4] > kMaxSum) continue;
    uint16_t wired[5];
    for (int i = 0; i < 5; ++i) wired[i] = falls ? static_cast<uint16_t>(kMaxSum - points[i]) : points[i];
    PotCurve fixed;
    if (!fixed.set(wired, full)) {
      printf("pot_curve refused a good curve\n");
      exit(1);
    }
    for (int k = 0; k < 20; ++k) {
      const uint16_t reading = static_cast<uint16_t>(between(0, kMaxSum));
      const uint16_t seen = falls ? static_cast<uint16_t>(kMaxSum - reading) : reading;
      worst = worst_of(worst, fixed.stroke(seen) - twin.stroke(reading));
    }
  }
  printf("pot_curve_sums %.4f\n", worst / 475.0);
}

}  // namespace

int main(int argc, char** argv) {
  const long steps = argc > 1 ? atol(argv[1]) : 1000000;
  observer(steps);
  rate_loop(steps);
  position_loop(steps);
  pot_curve(steps / 20);
  return 0;
}
