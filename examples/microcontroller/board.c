/* The loop on a Cortex-M without an operating system and without a heap.
 *
 * Writes signals.bin, a row of doubles for each communication point, and prints what the program
 * needs, by semihosting: a debugger or an emulator does it. Compiled by arm-none-eabi-gcc. */

#include <stdint.h>

#include "loop.h"

int main(void);
void start(void);

/* --- semihosting ------------------------------------------------------------------------------ */

enum { SYS_OPEN = 0x01, SYS_CLOSE = 0x02, SYS_WRITE0 = 0x04, SYS_WRITE = 0x05, SYS_EXIT = 0x18 };
enum { WRITE_BINARY = 5, APPLICATION_EXIT = 0x20026, RUN_TIME_ERROR = 0x20023 };

static uintptr_t semihosting(uintptr_t operation, uintptr_t argument) {
    register uintptr_t r0 __asm__("r0") = operation;
    register uintptr_t r1 __asm__("r1") = argument;
    __asm__ volatile("bkpt 0xab" : "+r"(r0) : "r"(r1) : "memory");
    return r0;
}

static void print(const char *text) {
    semihosting(SYS_WRITE0, (uintptr_t)text);
}

void say(const char *message) {
    print(message);
    print("\n");
}

static void print_number(const char *name, uint32_t number) {
    char digits[11], *first = digits + sizeof digits - 1;
    *first = 0;
    do *--first = (char)('0' + number % 10);
    while (number /= 10);
    print(name);
    say(first);
}

/* --- instructions of a step ------------------------------------------------------------------- */

/* The system timer, which counts down at the processor's clock. */
#define TIMER_CONTROL (*(volatile uint32_t *)0xe000e010)
#define TIMER_RELOAD (*(volatile uint32_t *)0xe000e014)
#define TIMER (*(volatile uint32_t *)0xe000e018)
enum { TIMER_MASK = 0xffffff, RUN_AT_PROCESSOR_CLOCK = 5 };

/* The emulator lets an instruction take 2^ICOUNT_SHIFT ns, and a tick of the 25 MHz clock 40 ns. */
#ifndef ICOUNT_SHIFT
#define ICOUNT_SHIFT 6
#endif

static uint32_t instructions(uint64_t ticks) {
    return (uint32_t)(ticks * 40 >> ICOUNT_SHIFT);
}

static uint32_t begun, steps, most;
static uint64_t all;
static uintptr_t file;

void record(const double *signals, size_t n) {
    uint32_t ticks = (begun - TIMER) & TIMER_MASK;
    if (steps++) { /* before the first one is the initialization */
        all += ticks;
        if (ticks > most) most = ticks;
    }
    uintptr_t row[] = {file, (uintptr_t)signals, n * sizeof *signals};
    if (semihosting(SYS_WRITE, (uintptr_t)row)) say("signals.bin: a row was not written");
    begun = TIMER;
}

/* --- start and end ---------------------------------------------------------------------------- */

/* From the linker script. */
extern uint32_t stack_bottom[], stack_top[], data_in_flash[], data_start[], data_end[], bss_end[];

/* Words of the stack that have not been used. */
#define UNUSED 0x5ac3a5c3u

static uint32_t bytes(const uint32_t *from, const uint32_t *to) {
    return (uint32_t)((uintptr_t)to - (uintptr_t)from);
}

static void run(void) {
    uintptr_t name[] = {(uintptr_t) "signals.bin", WRITE_BINARY, 11};
    file = semihosting(SYS_OPEN, (uintptr_t)name);
    TIMER_RELOAD = TIMER_MASK;
    TIMER_CONTROL = RUN_AT_PROCESSOR_CLOCK;

    int failed = main();

    semihosting(SYS_CLOSE, (uintptr_t)&file);
    if (failed || steps < 2) {
        say("a call of an FMU failed");
        semihosting(SYS_EXIT, RUN_TIME_ERROR);
    }
    const uint32_t *deepest = stack_bottom;
    while (*deepest == UNUSED) deepest++;
    print_number("steps: ", steps);
    print_number("instructions of a step: ", instructions(all / (steps - 1)));
    print_number("instructions of the longest step: ", instructions(most));
    print_number("bytes of flash: ", bytes(0, data_in_flash) + bytes(data_start, data_end));
    print_number("bytes of RAM: ", bytes(data_start, bss_end));
    print_number("bytes of stack: ", bytes(deepest, stack_top));
    semihosting(SYS_EXIT, APPLICATION_EXIT);
}

void start(void) {
    *(volatile uint32_t *)0xe000ed88 |= 0xf00000; /* CPACR: the floating-point unit is on */
    __asm__ volatile("dsb\n isb");
    const uint32_t *from = data_in_flash;
    for (uint32_t *to = data_start; to < data_end;) *to++ = *from++;
    for (uint32_t *to = data_end; to < bss_end;) *to++ = 0;
    uint32_t *sp;
    __asm__ volatile("mov %0, sp" : "=r"(sp));
    for (volatile uint32_t *to = stack_bottom; to < sp;) *to++ = UNUSED;
    run();
}

static void fault(void) {
    say("the processor stopped with a fault");
    semihosting(SYS_EXIT, RUN_TIME_ERROR);
}

/* The stack, and the functions that the processor calls: at reset, and for its kinds of faults. */
__attribute__((section(".vectors"), used)) static const struct {
    uint32_t *stack;
    void (*reset)(void), (*faults[5])(void);
} VECTORS = {stack_top, start, {fault, fault, fault, fault, fault}};
