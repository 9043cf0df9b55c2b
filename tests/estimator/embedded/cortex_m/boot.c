/* Start of a program on a Cortex-M of QEMU, with semihosting. */
#include <stdint.h>

extern void _start(void);

static void reset(void);

static void stop(void)
{
    for (;;) {
    }
}

__attribute__((section(".vectors"), used)) static void (*const VECTORS[16])(void) = {
    (void (*)(void))0x20400000, reset, stop, stop, stop, stop, stop,
};

__attribute__((used)) static void reset(void)
{
    *(volatile uint32_t *)0xE000ED88 |= 0xFu << 20; /* the FPU */
    __asm__ volatile("dsb\n isb");
    _start();
}
