/* The exported controller around 1/(s+1)^2, as a timer interrupt would call it every 10 ms. */
#include "fopid_controller.h"
#include <math.h>
#include <stdio.h>

static fopid_controller_state loop;
static float first, second; /* the plant: two lags of 1 s */

static float on_timer(float setpoint)
{
    float control = fopid_controller_step(&loop, setpoint, second, 0, 0);
    first += 0.01f * (control - first);
    second += 0.01f * (first - second);
    return control;
}

int main(void)
{
    float largest = 0;
    fopid_controller_init(&loop);
    for (int tick = 0; tick < 3000; tick++) {
        float control = on_timer(1.0f);
        if (fabsf(control) > largest)
            largest = fabsf(control);
    }
    printf("after 30 s: output %.3f, largest control %.2f\n", second, largest);
    return fabsf(second - 1.0f) < 0.02f && largest <= 5.0f ? 0 : 1;
}
