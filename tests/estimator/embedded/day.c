/* Hours of driving at 20 Hz, made in double precision: "HOURS TRACK" are the hours, and the effective track
 * [m]. Fixes of 0.05 m in half an hour of every six. Writes a row every ten minutes: stamp, health, then
 * value and variance of each state. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include "icreckon_filter.h"

static icr_filter filter;
static uint64_t seed = 88172645463325252u;

/* Noise of variance one, by twelve uniform numbers (xorshift). */
static double noise(void)
{
    double sum = -6.0;
    for (int k = 0; k < 12; k++) {
        seed ^= seed << 13;
        seed ^= seed >> 7;
        seed ^= seed << 17;
        sum += (double)(seed >> 11) / 9007199254740992.0;
    }
    return sum;
}

int main(int argc, char **argv)
{
    const double dt = 0.05, hours = argc > 2 ? atof(argv[1]) : 0.0, track = argc > 2 ? atof(argv[2]) : 1.0;
    const int64_t start = INT64_C(1700000000000000000);
    double x = 0.0, y = 0.0, yaw = 0.0, speed = 0.0, rate = 0.0;
    icr_init(&filter);
    for (long k = 0; k <= (long)(hours * 3600.0 / dt); k++) {
        const double t = (double)k * dt, in_cycle = fmod(t, 600.0), in_six = fmod(t, 21600.0);
        const int64_t stamp = start + (int64_t)k * 50000000;
        const double wanted = in_cycle < 20.0 ? 0.0 : 0.4 + 0.2 * sin(0.031 * t);
        const double turn = in_cycle < 20.0 ? 0.0 : 0.35 * sin(0.17 * t) * (1.0 + sin(0.0023 * t));
        const double before = speed;
        speed += 0.1 * (wanted - speed);
        rate += 0.1 * (turn - rate);
        if (wanted == 0.0 && speed < 1e-3) {
            speed = rate = 0.0;
        }
        x += speed * dt * cos(yaw + 0.5 * rate * dt);
        y += speed * dt * sin(yaw + 0.5 * rate * dt);
        yaw += rate * dt;
        const double moving = speed > 0.0 ? 0.005 : 0.0;
        icr_tracks(&filter, stamp, (icr_real)(speed - 0.5 * track * rate + moving * noise()),
                   (icr_real)(speed + 0.5 * track * rate + moving * noise()));
        const icr_real w[3] = {(icr_real)(0.002 * noise()), (icr_real)(0.002 * noise()),
                               (icr_real)(rate + 0.003 + 0.002 * noise())};
        const icr_real a[3] = {(icr_real)((speed - before) / dt + 0.05 * noise()),
                               (icr_real)(speed * rate + 0.05 * noise()), (icr_real)9.81};
        icr_imu(&filter, stamp, w, a);
        if (k % 20 == 10 && in_six < 1800.0) {
            icr_position(&filter, stamp + 1000000, (icr_real)(x + 0.05 * noise()),
                         (icr_real)(y + 0.05 * noise()), (icr_real)0.0025, 0, 0, 0);
        }
        if (k % 12000 == 11999) {
            printf("%lld,%u", (long long)stamp, (unsigned)icr_health_of(&filter));
            for (int state = 0; state < ICR_STATES; state++) {
                const enum icr_state of = (enum icr_state)state;
                printf(",%.17g,%.17g", (double)icr_state_of(&filter, of),
                       (double)icr_covariance_of(&filter, of, of));
            }
            printf("\n");
        }
    }
    return 0;
}
