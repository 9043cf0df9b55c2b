/* Mean and most instructions of a pair of samples, size of a filter, and the stack of its functions [bytes].
 * Samples are track speeds and IMU at 100 Hz. Needs `-icount shift=0`: an instruction
 * takes 1 ns then, and SysTick counts at 25 MHz. */
#include <math.h>
#include <stdint.h>
#include <stdio.h>

#include "icreckon_filter.h"

#define CONTROL (*(volatile uint32_t *)0xE000E010)
#define RELOAD (*(volatile uint32_t *)0xE000E014)
#define CURRENT (*(volatile uint32_t *)0xE000E018)
enum { PER_TICK = 40, PAIRS = 2000, PAINTED = 16384, CLOSE = 128 };

static icr_filter filter;

int main(void)
{
    int64_t stamp = INT64_C(1700000000000000000);
    uint64_t total = 0;
    uint32_t most = 0, deepest = CLOSE;
    volatile uint8_t *const here = (volatile uint8_t *)&most;
    for (int k = CLOSE; k < PAINTED; k++) {
        *(here - k) = 0xA5; /* the stack that is not used yet */
    }
    RELOAD = 0xFFFFFF;
    CURRENT = 0;
    CONTROL = 5;
    icr_init(&filter);
    for (int k = 0; k < PAIRS; k++) {
        /* It stands for three seconds, and drives. */
        const float drives = k < 300 ? 0.0f : 1.0f, turn = drives * 0.3f * sinf((float)k * 0.003f);
        const icr_real rates[3] = {0, 0, (icr_real)turn}, force[3] = {0, 0, (icr_real)9.81};
        uint32_t before, spent;
        stamp += 10000000;
        before = CURRENT;
        icr_tracks(&filter, stamp, (icr_real)(drives * 0.5f - 0.3f * turn), (icr_real)(drives * 0.5f + 0.3f * turn));
        icr_imu(&filter, stamp, rates, force);
        spent = (before - CURRENT) & 0xFFFFFF;
        total += spent;
        most = spent > most ? spent : most;
        if (k % 100 == 50) {
            icr_position(&filter, stamp, (icr_real)0.1, 0, 1, (icr_real)0.2, 0, 0);
            icr_heading(&filter, stamp, 0, 1);
            (void)icr_twist_of(&filter);
            (void)icr_health_of(&filter);
        }
    }
    for (int k = CLOSE; k < PAINTED; k++) {
        deepest = *(here - k) != 0xA5 ? (uint32_t)k : deepest;
    }
    printf("%lu %lu %lu %lu\n", (unsigned long)(total * PER_TICK / PAIRS), (unsigned long)most * PER_TICK,
           (unsigned long)sizeof filter, (unsigned long)deepest);
    return 0;
}
