#include "native_attitude_api.h"
#include "tiger/fusion/attitude_filter.h"
#include "tiger/fusion/wheel_aiding.h"

namespace fusion = tiger::fusion;

namespace {

fusion::AttitudeTuning full_tuning(const tiger_attitude_tuning& t) {
  fusion::AttitudeTuning tuning;
  tuning.tick_s = t.tick_s;
  tuning.mag_period_s = t.mag_period_s;
  tuning.slow_every = static_cast<uint8_t>(t.slow_every);
  tuning.accel_tau_s = t.accel_tau_s;
  tuning.heading.tau_s = t.mag_tau_s;
  tuning.bias.sigma_init_radps = t.bias_sigma_init_radps;
  tuning.bias.sigma_motion_radps = t.bias_sigma_motion_radps;
  tuning.bias.sigma_rest_radps = t.bias_sigma_rest_radps;
  return tuning;
}

fusion::Vec3 vec(const float* v) { return fusion::Vec3{v[0], v[1], v[2]}; }

void put(float* out, const fusion::Vec3& v) {
  out[0] = v.x;
  out[1] = v.y;
  out[2] = v.z;
}

void put(float* out, const fusion::Quat& q) {
  out[0] = q.w;
  put(out + 1, q.v);
}

}  // namespace

struct tiger_attitude {
  fusion::AttitudeGains gains;
  fusion::AidingGains aiding_gains;
  fusion::AttitudeFilter filter;
  fusion::WheelAiding aiding;

  explicit tiger_attitude(const tiger_attitude_tuning& t)
      : gains(fusion::attitude_gains(full_tuning(t))),
        aiding_gains(fusion::aiding_gains(fusion::AidingTuning(), t.tick_s)),
        filter(gains) {}

  void step(const tiger_attitude_sample& in, tiger_attitude_state& out) {
    fusion::ImuSample sample = {vec(in.gyro_radps), vec(in.accel_mps2), fusion::Vec3{0.0f, 0.0f, 0.0f},
                                in.accel_usable != 0, true};
    if (in.wheels != TIGER_WHEELS_NONE) {
      const fusion::Vec3 rate = sample.gyro_radps - filter.bias_radps();
      const auto advice = aiding.step(aiding_gains, in.speed_mps, in.wheels == TIGER_WHEELS_SLIP, rate);
      sample.vehicle_accel_mps2 = advice.vehicle_accel_mps2;
      sample.accel_usable = sample.accel_usable && advice.accel_usable;
      sample.may_rest = advice.may_rest;
    }
    if (in.follows_gap != 0) filter.resume();
    filter.sense(sample, in.dt_s);
    if (in.has_mag != 0) filter.add_magnetometer(vec(in.mag_ut));
    filter.think();
    put(out.quaternion, filter.attitude());
    put(out.level_quaternion, filter.attitude_without_heading());
    put(out.rate_radps, filter.rate_radps());
    put(out.bias_radps, filter.bias_radps());
    out.resting = filter.resting();
    out.disturbed = filter.magnetically_disturbed();
  }
};

void tiger_attitude_defaults(tiger_attitude_tuning* tuning) {
  const fusion::AttitudeTuning t;
  tuning->tick_s = t.tick_s;
  tuning->mag_period_s = t.mag_period_s;
  tuning->slow_every = t.slow_every;
  tuning->accel_tau_s = t.accel_tau_s;
  tuning->mag_tau_s = t.heading.tau_s;
  tuning->bias_sigma_init_radps = t.bias.sigma_init_radps;
  tuning->bias_sigma_motion_radps = t.bias.sigma_motion_radps;
  tuning->bias_sigma_rest_radps = t.bias.sigma_rest_radps;
}

tiger_attitude* tiger_attitude_new(const tiger_attitude_tuning* tuning) {
  return new tiger_attitude(*tuning);
}
void tiger_attitude_free(tiger_attitude* filter) { delete filter; }
void tiger_attitude_start_bias(tiger_attitude* filter, const float bias_radps[3]) {
  filter->filter.start_bias_from(vec(bias_radps));
}

void tiger_attitude_run(tiger_attitude* filter, uint32_t n, const tiger_attitude_sample* samples,
                        tiger_attitude_state* states) {
  for (uint32_t i = 0; i < n; ++i) filter->step(samples[i], states[i]);
}
