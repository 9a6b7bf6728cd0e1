// UART with a ring buffer each way, served by two short interrupts. Speeds are exact divisors of 16 MHz.
#pragma once

#include <avr/interrupt.h>
#include <avr/io.h>
#include <stdint.h>
#include <util/atomic.h>

namespace tiger {
namespace arduino {

struct Uart0Port {
  static volatile uint8_t& data() { return UDR0; }
  static volatile uint8_t& status() { return UCSR0A; }
  static volatile uint8_t& control() { return UCSR0B; }
  static volatile uint8_t& format() { return UCSR0C; }
  static volatile uint16_t& divisor() { return UBRR0; }
};

#if defined(UDR1)
struct Uart1Port {
  static volatile uint8_t& data() { return UDR1; }
  static volatile uint8_t& status() { return UCSR1A; }
  static volatile uint8_t& control() { return UCSR1B; }
  static volatile uint8_t& format() { return UCSR1C; }
  static volatile uint16_t& divisor() { return UBRR1; }
};
#endif

// Bytes between one writer and one reader, of which one is an interrupt. `Size` is a power of two; one place
// stays free to tell full from empty. Each index is a single byte, so reading one is atomic.
template <uint16_t Size>
class Ring {
 public:
  static_assert(Size <= 256 && (Size & (Size - 1)) == 0, "a ring holds a power of two, at most 256 bytes");
  static constexpr uint8_t kMask = Size - 1;

  __attribute__((always_inline)) bool push(uint8_t byte) {
    const uint8_t next = after(head_);
    if (next == tail_) return false;
    bytes_[head_] = byte;
    head_ = next;
    return true;
  }
  __attribute__((always_inline)) bool pop(uint8_t& byte) {
    const uint8_t tail = tail_;
    if (tail == head_) return false;
    byte = bytes_[tail];
    tail_ = after(tail);
    return true;
  }
  bool empty() const { return head_ == tail_; }
  uint8_t space() const { return static_cast<uint8_t>((tail_ - head_ - 1) & kMask); }
  void clear() { head_ = tail_ = 0; }

 private:
  static uint8_t after(uint8_t index) { return static_cast<uint8_t>((index + 1) & kMask); }

  volatile uint8_t head_;
  volatile uint8_t tail_;
  volatile uint8_t bytes_[Size];
};

template <class Port, uint16_t ReceiveSize, uint16_t SendSize>
class Uart {
 public:
  void begin(uint32_t baud) {
    received_.clear();
    sending_.clear();
    Port::status() = _BV(U2X0);
    Port::divisor() = static_cast<uint16_t>(F_CPU / 8 / baud - 1);
    Port::format() = _BV(UCSZ01) | _BV(UCSZ00);  // 8N1
    Port::control() = _BV(RXEN0) | _BV(TXEN0) | _BV(RXCIE0);
  }

  bool read(uint8_t& byte) { return received_.pop(byte); }
  uint8_t write_space() const { return sending_.space(); }

  // The caller has checked write_space().
  void write(const uint8_t* bytes, uint8_t n) {
    for (uint8_t i = 0; i < n; ++i) sending_.push(bytes[i]);
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) { Port::control() |= _BV(UDRIE0); }
  }

  // Budget 80 cycles. A byte that finds the ring full is dropped: its frame then fails its length or checksum
  // and is counted there.
  __attribute__((always_inline)) void on_receive() { received_.push(Port::data()); }

  // Budget 80 cycles.
  __attribute__((always_inline)) void on_data_register_empty() {
    uint8_t byte;
    if (sending_.pop(byte)) Port::data() = byte;
    if (sending_.empty()) Port::control() &= static_cast<uint8_t>(~_BV(UDRIE0));
  }

 private:
  Ring<ReceiveSize> received_;
  Ring<SendSize> sending_;
};

}  // namespace arduino
}  // namespace tiger
