// SPDX-License-Identifier: GPL-3.0-or-later
#include "twi_device.h"

std::unique_ptr<TwiDevice> make_bno055() { return std::unique_ptr<TwiDevice>(new RegisterFile); }
