/* Feed random and hostile measurements to a filter: hostile SECONDS SEED. Fails if a state or a variance is
 * not finite, a variance is negative, or a result is not in the header. */
#include <float.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include "icreckon_filter.h"

static icr_filter filter;
static uint64_t seed;

static double uniform(void)
{
    seed = seed * UINT64_C(6364136223846793005) + UINT64_C(1442695040888963407);
    return (double)(seed >> 11) / 9007199254740992.0;
}

static double symmetric(double most)
{
    return most * (2.0 * uniform() - 1.0);
}

/* A usual value, or a hostile one. */
static icr_real value(double usual, double share)
{
    static const double HOSTILE[] = {NAN, INFINITY, -INFINITY, 0.0, 1e30, -1e30, 1e-30, 99.0, -999.0, 9e9, DBL_MAX};
    if (uniform() < share) {
        const double hostile = HOSTILE[(int)(uniform() * 11.0)];
        return (icr_real)(hostile > (double)FLT_MAX && isfinite(hostile) ? (double)FLT_MAX : hostile);
    }
    return (icr_real)usual;
}

static int64_t hostile_stamp(int64_t now)
{
    static const int64_t AT[] = {INT64_MIN, INT64_MAX, 0, -1, 1};
    const int which = (int)(uniform() * 8.0);
    return which < 5 ? AT[which] : now + (int64_t)symmetric(which == 5 ? 1e9 : which == 6 ? 1e11 : 1e14);
}

int main(int argc, char **argv)
{
    const double seconds = argc > 1 ? atof(argv[1]) : 60.0;
    int64_t now = INT64_C(1700000000000000000);
    long counts[ICR_NO_TRACKS + 1] = {0}, wrong = 0, fed = 0;
    seed = argc > 2 ? (uint64_t)atoll(argv[2]) : 1u;
    icr_init(&filter);
    for (long k = 0; k < (long)(seconds * 200.0); k++) {
        /* Calm minutes, and hostile ones. */
        const double share = k / 6000 % 2 ? 0.02 : 0.0;
        const int64_t stamp = uniform() < share ? hostile_stamp(now) : now;
        const double speed = 0.5 + 0.4 * sin((double)k * 1e-3), turn = 0.3 * sin((double)k * 3e-4);
        int result = 0;
        if (k % 4 == 0) {
            result = icr_tracks(&filter, stamp, value(speed - turn + symmetric(0.02), share),
                                value(speed + turn + symmetric(0.02), share));
        } else if (k % 2 == 0 || share > 0.0) {
            icr_real rates[3], force[3];
            for (int axis = 0; axis < 3; axis++) {
                rates[axis] = value(symmetric(0.01) + (axis == 2 ? turn : 0.0), share);
                force[axis] = value(symmetric(0.1) + (axis == 2 ? 9.81 : 0.0), share);
            }
            result = icr_imu(&filter, stamp, rates, uniform() < share ? NULL : force);
        } else if (k % 200 == 1) {
            result = icr_position(&filter, stamp, value((double)k * 1e-3 + symmetric(1.0), 10.0 * share),
                                  value(symmetric(1.0), 10.0 * share), value(0.01, 10.0 * share),
                                  value(0.2, share), value(0.1, share), value(0.4, share));
        } else if (k % 200 == 51) {
            result = icr_heading(&filter, stamp, value(symmetric(3.0), 10.0 * share), value(0.01, 10.0 * share));
        } else if (k % 200 == 101) {
            result = icr_velocity(&filter, stamp, value(speed + symmetric(0.1), 10.0 * share),
                                  value(symmetric(0.1), 10.0 * share), value(0.01, 10.0 * share));
        } else if (k % 200 == 151) {
            const icr_real sigma[3] = {value(1.0, 10.0 * share), value(1.0, 10.0 * share), value(0.5, 10.0 * share)};
            result = icr_zero_velocity(&filter, stamp, share > 0.0 && k % 400 == 151 ? NULL : sigma);
        }
        if (result < ICR_USED || result > ICR_NO_TRACKS) {
            printf("result %d\n", result);
            return 1;
        }
        counts[result]++;
        fed++;
        if (result <= ICR_REPEATED && stamp > now) {
            now = stamp; /* a jump ahead that was taken: those behind it would be late */
        }
        now += 5000000;
        if (k % 5 == 0) {
            const icr_twist twist = icr_twist_of(&filter);
            const icr_icrs icrs = icr_icrs_of(&filter);
            (void)icr_health_of(&filter);
            wrong += !isfinite((double)twist.w) || !isfinite((double)icrs.x);
        }
        for (int i = 0; i < ICR_STATES; i++) {
            const enum icr_state state = (enum icr_state)i;
            const double variance = (double)icr_covariance_of(&filter, state, state);
            if (!(variance >= 0.0) || !isfinite(variance) || !isfinite((double)icr_state_of(&filter, state))) {
                if (wrong++ < 5) {
                    printf("%ld: %s is %g, variance %g\n", k, icr_name_of(state),
                           (double)icr_state_of(&filter, state), variance);
                }
            }
        }
    }
    printf("%ld fed, %ld wrong; used %ld, rejected %ld, repeated %ld, late %ld, ahead %ld, invalid %ld\n", fed, wrong,
           counts[ICR_USED], counts[ICR_REJECTED], counts[ICR_REPEATED], counts[ICR_LATE], counts[ICR_AHEAD],
           counts[ICR_INVALID]);
    return wrong != 0;
}
