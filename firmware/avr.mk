# The three images: avr-gcc with the flags of the Arduino IDE (gnu++11, link-time optimisation), the core of Debian's
# arduino-core-avr. Only our own sources are held to the strict warnings.
#
#   make firmware                                       build/firmware/<board>.hex, with flash and RAM
#   make flash BOARD=... PORT=... [BOOTLOADER=old] [INSTANCE=right] [DRY_RUN=1]
#   make budget                                         firmware/BUDGET.md, measured in simavr

# Every file is written beside its place and moved there: two makes at once do not read each other's halves.
BOARDS := mega_suspension nano_imu mega_speed

MCU_mega_suspension := atmega2560
MCU_mega_speed      := atmega2560
MCU_nano_imu        := atmega328p
VARIANT_atmega2560 := mega
VARIANT_atmega328p := eightanaloginputs
DEFINE_atmega2560 := ARDUINO_AVR_MEGA2560
DEFINE_atmega328p := ARDUINO_AVR_NANO

ARDUINO ?= /usr/share/arduino/hardware/arduino/avr
AVR_TOOLS ?=
AVR_CC := $(AVR_TOOLS)avr-gcc
AVR_CXX := $(AVR_TOOLS)avr-g++
AVR_AR := $(AVR_TOOLS)avr-gcc-ar
AVR_OBJCOPY := $(AVR_TOOLS)avr-objcopy
AVR_SIZE := $(AVR_TOOLS)avr-size
AVR_OUT := build/firmware

# The revision goes into HELLO, so that a log says which sources a board runs.
GIT_REVISION := $(shell git rev-parse --short=8 HEAD 2>/dev/null)
GIT_DIRTY := $(shell git diff --quiet HEAD -- firmware protocol 2>/dev/null && echo 0 || echo 1)
AVR_REVISION := -DTIGER_GIT=0x$(if $(GIT_REVISION),$(GIT_REVISION),0)UL -DTIGER_DIRTY=$(GIT_DIRTY)

avr_common = -Os -g -ffunction-sections -fdata-sections -flto -fno-fat-lto-objects -mmcu=$(1) -DF_CPU=16000000L \
  -DARDUINO=10819 -D$(DEFINE_$(1)) -DARDUINO_ARCH_AVR \
  -I$(ARDUINO)/cores/arduino -I$(ARDUINO)/variants/$(VARIANT_$(1))
avr_cxx = $(avr_common) -std=gnu++11 -fno-exceptions -fno-threadsafe-statics
AVR_STRICT := -Wall -Wextra -Werror -Wshadow -Wconversion
AVR_LIBRARIES := -Ifirmware/libraries/TigerCore/src -Ifirmware/libraries/TigerArduino/src
AVR_CORE_FLAGS := -fpermissive -w -DDECIMAL_DIG=__DECIMAL_DIG__   # hidden from C++ by float.h of gcc 5, wanted by WString.cpp

AVR_CORE_C := $(notdir $(wildcard $(ARDUINO)/cores/arduino/*.c))
AVR_CORE_CXX := $(notdir $(wildcard $(ARDUINO)/cores/arduino/*.cpp))

define avr_core
$(AVR_OUT)/core_$(1)/%.c.o: $(ARDUINO)/cores/arduino/%.c
	@mkdir -p $$(@D)
	@$(AVR_CC) $$(call avr_common,$(1)) -std=gnu11 -w -c $$< -o $$@
$(AVR_OUT)/core_$(1)/%.cpp.o: $(ARDUINO)/cores/arduino/%.cpp
	@mkdir -p $$(@D)
	@$(AVR_CXX) $$(call avr_cxx,$(1)) $(AVR_CORE_FLAGS) -c $$< -o $$@
$(AVR_OUT)/core_$(1).a: $(addprefix $(AVR_OUT)/core_$(1)/,$(AVR_CORE_C:%=%.o) $(AVR_CORE_CXX:%=%.o))
	@rm -f $$@.new
	@$(AVR_AR) rcs $$@.new $$^ && mv $$@.new $$@
endef
$(foreach mcu,atmega2560 atmega328p,$(eval $(call avr_core,$(mcu))))

define avr_board
$(AVR_OUT)/$(1).o: firmware/$(1)/$(1).ino $(AVR_OUT)/revision
	@mkdir -p $$(@D)
	@$(AVR_CXX) $$(call avr_cxx,$(MCU_$(1))) $(AVR_STRICT) $(AVR_LIBRARIES) $(AVR_REVISION) -MMD -MP -include Arduino.h \
	  -MT $$@ -MF $$(@:.o=.d) -x c++ -c $$< -o $$@.new && mv $$@.new $$@
$(AVR_OUT)/$(1).elf: $(AVR_OUT)/$(1).o $(AVR_OUT)/core_$(MCU_$(1)).a
	@$(AVR_CXX) -Os -g -flto -fuse-linker-plugin -Wl,--gc-sections -mmcu=$(MCU_$(1)) -o $$@.new $$^ -lm && mv $$@.new $$@
-include $(AVR_OUT)/$(1).d
endef
$(foreach board,$(BOARDS),$(eval $(call avr_board,$(board))))

$(AVR_OUT)/%.hex: $(AVR_OUT)/%.elf
	@$(AVR_OBJCOPY) -O ihex -R .eeprom $< $@.new && mv $@.new $@

# Touched only when the revision changes, so that the images are rebuilt then and not otherwise.
$(AVR_OUT)/revision: FORCE
	@mkdir -p $(@D)
	@echo '$(AVR_REVISION)' | cmp -s - $@ || echo '$(AVR_REVISION)' > $@

.PHONY: FORCE
FORCE:

.PHONY: firmware
firmware: system-avr ## Build the three AVR images and show their flash and RAM
	@$(MAKE) --no-print-directory firmware-images
.PHONY: firmware-images
firmware-images: $(BOARDS:%=$(AVR_OUT)/%.hex)
	@AVR_SIZE=$(AVR_SIZE) $(PYTHON) firmware/budget.py sizes $(BOARDS:%=$(AVR_OUT)/%.elf)

.PHONY: budget
budget: setup firmware ## Measure flash, RAM, stack and cycles in simavr; write firmware/BUDGET.md
	@$(BIN)/python firmware/budget.py write

.PHONY: flash
flash: ## Put an image on a board: BOARD= PORT= [BOOTLOADER=old] [INSTANCE=left|right] [DRY_RUN=1]
	@$(PYTHON) firmware/flash.py check --board '$(BOARD)' --port '$(PORT)' --bootloader '$(BOOTLOADER)' --instance '$(INSTANCE)'
	@scripts/system-packages.sh flash
	@$(MAKE) --no-print-directory $(AVR_OUT)/$(BOARD).hex
	@AVR_SIZE=$(AVR_SIZE) $(PYTHON) firmware/budget.py sizes $(AVR_OUT)/$(BOARD).elf
	@$(PYTHON) firmware/flash.py run --board '$(BOARD)' --port '$(PORT)' --bootloader '$(BOOTLOADER)' --instance '$(INSTANCE)' \
	  $(if $(DRY_RUN),--dry-run)
