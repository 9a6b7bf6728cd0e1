// A program on its virtual chip: time, reset, hang and watchdog.
//
// A board is added by three files beside this one:
//   native_<board>.h       class <Board>Hal : public NativeHal (hides advance, reset, begin_run, end_run
//                          and watchdog_interrupt where it has something to do there; adds the pins), and
//                          tiger_board* new_<board>(uint8_t instance, uint32_t uid)
//                          { return new NativeBoard<<Board>Hal, <Board>>(instance, uid); }
//   native_<board>_api.h   plain C declarations of its pins, tiger_<board>_...(tiger_board*, ...)
//   native_<board>.cpp     their definitions: hal_of<<Board>Hal>(board)
// and one line in tiger_native.cpp.
#pragma once

#include <stdint.h>
#include <string.h>

#include <new>

#include "native_hal.h"

struct tiger_board {
  virtual ~tiger_board() {}
  virtual void run(uint32_t us) = 0;
  virtual void reset(uint8_t mcusr) = 0;
  virtual void hang(bool interrupts_off) = 0;
  virtual void set_turn(uint32_t us) = 0;
  virtual tiger::NativeHal& hal() = 0;
  virtual tiger::VirtualUart* uart(uint8_t port) = 0;
};

namespace tiger {

template <class Hal>
Hal& hal_of(tiger_board* board) {
  return static_cast<Hal&>(board->hal());
}

template <class Hal, template <class> class Program>
class NativeBoard final : public tiger_board {
 public:
  NativeBoard(uint8_t instance, uint32_t uid) : hal_(instance, uid) { boot(NativeHal::kPowerOn); }
  ~NativeBoard() override { program().~Program<Hal>(); }

  void run(uint32_t us) override {
    const uint64_t end_ns = hal_.now_ns() + uint64_t{us} * 1000;
    hal_.begin_run(us);
    while (hal_.now_ns() < end_ns) {
      const uint64_t left_ns = end_ns - hal_.now_ns();
      hal_.advance(hal_.now_ns() + (left_ns < turn_ns_ ? left_ns : turn_ns_));
      if (!hung_) program().poll();
      watch();
    }
    hal_.end_run();
  }

  void reset(uint8_t mcusr) override {
    program().~Program<Hal>();
    boot(mcusr);
  }

  void hang(bool interrupts_off) override {
    hung_ = true;
    interrupts_off_ = interrupts_off;
  }

  void set_turn(uint32_t us) override { turn_ns_ = uint64_t{us} * 1000; }

  NativeHal& hal() override { return hal_; }
  VirtualUart* uart(uint8_t port) override { return hal_.uart(port); }

 private:
  static constexpr uint64_t kWatchdogNs = uint64_t{kWatchdogMs} * 1000000;

  void boot(uint8_t mcusr) {
    hal_.reset(mcusr);
    hung_ = interrupts_off_ = bitten_ = false;
    memset(memory_, 0xA5, sizeof(memory_));  // whoever reads RAM before writing it reads this
    new (memory_) Program<Hal>(hal_);
    program().begin();
  }

  // First time-out: the interrupt, if it may run. Second one: reset.
  void watch() {
    if (hal_.hungry_ns() >= 2 * kWatchdogNs) {
      reset(NativeHal::kWatchdog);
    } else if (hal_.hungry_ns() < kWatchdogNs) {
      bitten_ = false;
    } else if (!bitten_ && !interrupts_off_) {
      bitten_ = true;
      hal_.watchdog_interrupt();
    }
  }

  Program<Hal>& program() { return *reinterpret_cast<Program<Hal>*>(memory_); }

  Hal hal_;
  uint64_t turn_ns_ = 250000;
  bool hung_ = false;
  bool interrupts_off_ = false;
  bool bitten_ = false;  // the watchdog's interrupt has run
  alignas(16) unsigned char memory_[sizeof(Program<Hal>)];
};

}  // namespace tiger
