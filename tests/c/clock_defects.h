/* The defects with which `clocked.c` can be compiled: the name of each, the interface type that shows it, the rule by
 * which the validator must find it, and what the FMU gets wrong. The rule is NULL if the defect may be right.
 */

/* Intervals. */
PLANT(INTERVAL_REFUSED, CS, "interval-given", "fmi3GetIntervalDecimal refuses a changing clock")
PLANT(SHIFT_REFUSED, CS, "interval-given", "fmi3GetShiftDecimal refuses a fixed clock without interval in the XML")
PLANT(INTERVAL_NOT_GIVEN_AGAIN, CS, "interval-given", "a changing clock that has ticked gives no new interval")
PLANT(QUALIFIER_UNKNOWN, CS, "interval-qualifier", "the qualifier of an interval is 3")
PLANT(NEVER_KNOWN, CS, "interval-qualifier", "the interval of a fixed clock is not yet known")
PLANT(INTERVAL_ZERO, CS, "interval-positive", "the interval of a fixed clock is 0")
PLANT(INTERVAL_NAN, CS, "interval-positive", "the interval of a countdown clock has changed to NaN")
PLANT(INTERVAL_NEGATIVE, SE, "interval-positive", "the interval of a countdown clock has changed to -1 s")
PLANT(FRACTION_DIFFERS, CS, "interval-fraction", "the interval of a clock is another one as a fraction")
PLANT(FRACTION_REFUSED, CS, "interval-fraction", "fmi3GetIntervalFraction refuses a clock with supportsFraction")

/* Clocks and clocked variables. */
PLANT(TICK_REFUSED, CS, "runs", "fmi3SetClock refuses a clock whose time has come")
PLANT(CLOCK_STAYS_ACTIVE, CS, "clock-deactivated", "an output clock is active after fmi3UpdateDiscreteStates")
PLANT(CLOCK_ACTIVE_ONCE, CS, "clock-read", "an output clock is inactive when it is read a second time in event mode")
PLANT(OUTPUT_CLOCK_SETTABLE, CS, "settable", "fmi3SetClock accepts an output clock")
PLANT(UNKNOWN_CLOCK_READ, CS, "unknown-references", "fmi3GetClock reads an unknown value reference")
PLANT(CLOCKED_CHANGES, CS, "clocked-kept", "a clocked output changes between its ticks")
PLANT(CLOCKED_SETTABLE, CS, "clocked-settable", "a clocked input can be set while its clock is inactive")
PLANT(NEVER_SENT, CS, NULL, "an output clock never ticks")
PLANT(STEPS_IN_EVENT_MODE, CS, NULL, "fmi3DoStep accepts a call in event mode")
PLANT(EVALUATION_COUNTS, CS, "evaluate-once", "fmi3EvaluateDiscreteStates counts the ticks")
PLANT(EVENTS_NEVER_END, CS, "runs", "fmi3UpdateDiscreteStates always asks for another call")
PLANT(COUNTDOWN_OF_ZERO, CS, "runs", "a countdown clock ticks again and again at one time")
PLANT(RESET_KEEPS_TICKS, CS, "reset", "fmi3Reset keeps the number of ticks")
PLANT(STATE_LOSES_TICKS, CS, "state", "the FMU state lacks the number of ticks")
PLANT(STATE_LOSES_INTERVAL, SE, "state", "the FMU state lacks the interval of the changing clock")

/* Binaries. */
PLANT(BINARY_TOO_LARGE, CS, "binary-size", "a Binary is larger than maxSize")
PLANT(BINARY_NULL, CS, "runs", "a Binary of 24 bytes is NULL")
PLANT(BINARY_GROWS, CS, "binary-kept", "a Binary has more bytes each time it is read")
PLANT(OPERATION_TRUNCATED, CS, "bus-operations", "an operation is shorter than its header")
PLANT(OPERATION_TOO_LONG, CS, "bus-operations", "an operation is longer than its Binary")
PLANT(OPERATION_UNKNOWN, CS, "bus-operations", "an operation has a code that CAN does not have")
PLANT(FRAME_TOO_LONG, CS, "bus-operations", "a frame of CAN has 9 bytes")

/* Scheduled execution. */
PLANT(LOCK_KEPT, SE, "preemption-unlocked", "a model partition locks preemption and does not unlock it")
PLANT(UPDATE_WITHOUT_REASON, SE, "clock-update", "fmi3ClockUpdateCallback is called though no clock has changed")
PLANT(UPDATE_OUTSIDE, SE, "clock-update", "fmi3ClockUpdateCallback is called during initialization")
PLANT(CLOCK_ACTIVE_TWICE, SE, "clock-read", "an output clock is active each time that it is read in clock update mode")
PLANT(PARTITION_TOO_EARLY, SE, "partition-order", "a model partition can be activated before initialization")
PLANT(PARTITION_BACKWARDS, SE, "partition-order", "a model partition can be activated at an earlier time")
PLANT(PARTITION_OF_OUTPUT, SE, "partition-order", "an output clock is accepted as the clock of a model partition")
PLANT(PARTITION_TOUCHES_OTHERS, SE, "clocked-kept", "a model partition changes the output of another one")
PLANT(PARTITION_HANGS, SE, "survives", "a model partition does not return")
