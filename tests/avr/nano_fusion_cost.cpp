// What the attitude filter costs on the ATmega328P: 1200 ticks of motion and of rest, timed by timer 1; then two
// numbers on the serial line, little-endian: mean and worst cycles of a tick.
#include <avr/io.h>

#include "tiger/boards/nano_imu_config.h"

using namespace tiger::fusion;

static AttitudeFilter filter(tiger::nano_imu_config::kAttitude);
static uint32_t chance = 1;
volatile float sink;

static float noise() {
  chance = chance * 1664525u + 1013904223u;
  return static_cast<float>(static_cast<int32_t>(chance >> 8)) * (1.0f / 8388608.0f) - 1.0f;
}

static void send(uint32_t value) {
  for (uint8_t i = 0; i < 4; i++) {
    while ((UCSR0A & _BV(UDRE0)) == 0) {
    }
    UDR0 = static_cast<uint8_t>(value >> (8 * i));
  }
}

int main() {
  constexpr uint16_t kTicks = 1200;
  UBRR0 = 3;  // 250 000 baud
  UCSR0B = _BV(TXEN0);
  TCCR1B = _BV(CS11);  // 8 cycles a count
  uint32_t total = 0;
  uint32_t worst = 0;
  for (uint16_t tick = 0; tick < kTicks; tick++) {
    const bool moves = tick < 600 || tick > 900;
    const float gyro = moves ? 0.5f : 0.002f;
    const float accel = moves ? 3.0f : 0.02f;
    ImuSample sample;
    sample.gyro_radps = Vec3{0.01f + gyro * noise(), gyro * noise(), gyro * noise()};
    sample.accel_mps2 = Vec3{accel * noise(), accel * noise(), 9.8f + accel * noise()};
    sample.vehicle_accel_mps2 = Vec3{0.0f, 0.0f, 0.0f};
    sample.accel_usable = sample.may_rest = true;
    const Vec3 field = {noise(), 20.0f + noise(), -45.0f + noise()};

    TCNT1 = 0;
    filter.sense(sample, 0.01f);
    if (tick % 5 == 0) filter.add_magnetometer(field);
    filter.think();
    const Quat q = filter.attitude();
    const uint32_t cycles = 8ul * TCNT1;

    sink = q.w;
    total += cycles;
    if (cycles > worst) worst = cycles;
  }
  send(total / kTicks);
  send(worst);
  for (;;) {
  }
}
