/* ${name}.h: a fractional-order PID controller, C(s) = kp + ki s^-lam + kd s^mu
 *
 *   kp = ${kp}, ki = ${ki}, kd = ${kd}, lam = ${lam}, mu = ${mu}
 *   one tick every ${sample_time} s; fractional powers met from ${low} to ${high} rad/s by ${lags} lags
 *   measurement: ${measurement_filter}
 *   limits ${control_min} to ${control_max}, at most ${control_rate_max} per second; anti-windup: ${antiwindup}
 *
 * C99, no library, no memory from the heap, constant work per tick. Written by fopid ${version}.
 *
 * Call ${name}_init once, then ${name}_step every ${sample_time} s:
 *
 *   static ${name}_state loop;
 *   ${name}_init(&loop);
 *   for (;;) {
 *       wait_for_tick();
 *       actuate(${name}_step(&loop, setpoint, read_sensor(), 0, 0));
 *   }
 *
 * A whole program, the loop with the process 1/(s + 1), is at the end of this file:
 *
 *   cc -std=c99 -D${NAME}_EXAMPLE -x c ${name}.h -o example && ./example
 *
 * ${NAME}_REAL is the type of every number: double, unless defined before. With float, keep lam at 1 or below: above,
 * the integral is a difference of large numbers, and a float holds seven digits. Numbers that decay may become
 * subnormal; on a processor that is slow with them, switch them to zero (on Arm: the FZ bit of FPSCR).
 */
#ifndef ${NAME}_H
#define ${NAME}_H

#ifndef ${NAME}_REAL
#define ${NAME}_REAL double
#endif
#define ${NAME}_LAGS ${lags}
#define ${NAME}_NO_LIMIT 1e30 /* inputs must be smaller, too */

typedef ${NAME}_REAL ${name}_real;

/* All that the controller remembers. */
typedef struct {
    ${name}_real lags[${NAME}_LAGS], area, error;                     /* of the integrated error */
    ${name}_real washouts[${NAME}_LAGS], value, slope, curvature;     /* of the differentiated signal, filtered */
    ${name}_real unfiltered;                                          /* and not */
    ${name}_real origin, differentiated, shift;                       /* first measurement; raw signal; taken out of it */
    ${name}_real proportional, integral, derivative, feedforward;     /* the parts of the control */
    ${name}_real bias;                                                /* what bumpless changes left in the integral */
    ${name}_real control, remembered;                                 /* given; and what is remembered stands for */
    ${name}_real filtered_re, filtered_im, filter_input, filter_origin; /* of the filter of the measurement */
    ${name}_real setpoint, last_error;                                /* within its rate; without its deadband */
    ${name}_real control_min, control_max, control_step;              /* limits; largest change per tick */
    ${name}_real owed, ticks_to_pay;                                  /* of the bias: what holds left; how long it goes */
    int manual, started, held;                                        /* flags */
} ${name}_state;

/* Each lag per tick: x += leak x + from_last (last input) + from_new (new input), or + of_slope (slope). */
static const ${name}_real ${name}_leak[${NAME}_LAGS] = {${leak}};
static const ${name}_real ${name}_from_last[${NAME}_LAGS] = {${from_last}};
static const ${name}_real ${name}_from_new[${NAME}_LAGS] = {${from_new}};
static const ${name}_real ${name}_of_slope[${NAME}_LAGS] = {${of_slope}};
/* The weights that read ki s^-lam and kd s^mu. */
static const ${name}_real ${name}_integral_weights[${NAME}_LAGS] = {${integral_weights}};
static const ${name}_real ${name}_derivative_weights[${NAME}_LAGS] = {${derivative_weights}};

static inline ${name}_real ${name}_within(${name}_real value, ${name}_real low, ${name}_real high)
{
    return value < low ? low : value > high ? high : value;
}

static inline int ${name}_usable(${name}_real value)
{
    return value >= -(${name}_real)${NAME}_NO_LIMIT && value <= (${name}_real)${NAME}_NO_LIMIT;
}

/* Forget the past; limits and mode stay. */
static inline void ${name}_reset(${name}_state *c)
{
    static const ${name}_state nothing = {0};
    const ${name}_real low = c->control_min, high = c->control_max, step = c->control_step;
    const int manual = c->manual;
    *c = nothing;
    c->control_min = low;
    c->control_max = high;
    c->control_step = step;
    c->manual = manual;
    c->control = c->remembered = (${name}_real)${safe_control};
}

/* Other limits from the next tick on; rate per second; ${NAME}_NO_LIMIT for none. */
static inline void ${name}_set_limits(${name}_state *c, ${name}_real low, ${name}_real high, ${name}_real rate)
{
    c->control_min = low;
    c->control_max = high;
    c->control_step = rate < (${name}_real)${NAME}_NO_LIMIT ? rate * (${name}_real)${sample_time} : rate;
}

static inline void ${name}_init(${name}_state *c)
{
    c->manual = 0;
    ${name}_set_limits(c, (${name}_real)${control_min}, (${name}_real)${control_max}, (${name}_real)${control_rate_max});
    ${name}_reset(c);
}

/* The integral goes on from so much higher. */
static inline void ${name}_take_up(${name}_state *c, ${name}_real step)
{
    c->bias += step;
    c->integral += step;
}

/* The same for a hold. A controller that does not integrate gives it back in as many ticks as were held. */
static inline void ${name}_owe(${name}_state *c, ${name}_real step)
{
    ${name}_take_up(c, step);
    c->owed += step;
}

/* Manual (not 0): the control follows the argument manual of step. The control does not jump either way. */
static inline void ${name}_set_manual(${name}_state *c, int manual)
{
    if (c->manual && !manual) {
        ${name}_take_up(c, c->control - c->proportional - c->integral - c->derivative - c->feedforward);
        c->owed = c->ticks_to_pay = 0;
    }
    c->manual = manual != 0;
}

static inline ${name}_real ${name}_limit(const ${name}_state *c, ${name}_real wanted)
{
    wanted = ${name}_within(wanted, c->control_min, c->control_max);
    return ${name}_within(wanted, c->control - c->control_step, c->control + c->control_step);
}

/* One tick without usable inputs: the control stays or goes to another value; the next step goes on from there. */
static inline ${name}_real ${name}_hold(${name}_state *c, ${name}_real wanted)
{
    const ${name}_real held = ${name}_limit(c, ${name}_usable(wanted) ? wanted : c->control);
    ${name}_owe(c, held - c->proportional - c->integral - c->derivative - c->feedforward);
    c->control = c->remembered = held;
    c->held = 1;
    c->ticks_to_pay += 1;
    return held;
}

/* What is remembered takes in a change of the error at the last tick. */
static inline void ${name}_correct(${name}_state *c, ${name}_real error)
{
    const ${name}_real value = (${name}_real)${filter_from_new} * error;
    const ${name}_real slope = value / (${name}_real)${sample_time};
    int i;
    for (i = 0; i < ${NAME}_LAGS; i++) {
        c->lags[i] += ${name}_from_new[i] * error;
        c->washouts[i] += ${name}_of_slope[i] * slope;
    }
    c->area += (${name}_real)${half_step} * error;
    c->error += error;
    c->value += value;
    c->slope += slope;
    c->curvature += slope / (${name}_real)${sample_time};
    c->unfiltered += error;
}

/* s^-lam of one signal and s^mu of the other, at their next samples; all parts of the control but the proportional. */
static inline void ${name}_carry_on(${name}_state *c, ${name}_real integrated, ${name}_real differentiated)
{
    const ${name}_real value = (${name}_real)${filter_decay} * c->value + (${name}_real)${filter_from_last} * c->unfiltered
                               + (${name}_real)${filter_from_new} * differentiated;
    const ${name}_real slope = (value - c->value) / (${name}_real)${sample_time};
    const ${name}_real curvature = (slope - c->slope) / (${name}_real)${sample_time};
    const ${name}_real jerk = (curvature - c->curvature) / (${name}_real)${sample_time};
    ${name}_real integral, derivative;
    int i;
    c->area += (${name}_real)${half_step} * (c->error + integrated);
    integral = (${name}_real)${integral_area} * c->area + (${name}_real)${integral_direct} * integrated;
    derivative = (${name}_real)${derivative_direct} * value + (${name}_real)${derivative_slope} * slope
                 + (${name}_real)${derivative_curvature} * curvature + (${name}_real)${derivative_jerk} * jerk;
    for (i = 0; i < ${NAME}_LAGS; i++) {
        c->lags[i] += ${name}_leak[i] * c->lags[i] + ${name}_from_last[i] * c->error + ${name}_from_new[i] * integrated;
        c->washouts[i] += ${name}_leak[i] * c->washouts[i] + ${name}_of_slope[i] * slope;
        integral += ${name}_integral_weights[i] * c->lags[i];
        derivative += ${name}_derivative_weights[i] * c->washouts[i];
    }
    c->error = integrated;
    c->value = value;
    c->slope = slope;
    c->curvature = curvature;
    c->unfiltered = differentiated;
    c->integral = integral + c->bias;
    c->derivative = derivative;
}

/* The measurement behind its filter, the real part of one complex lag. */
static inline ${name}_real ${name}_filter(${name}_state *c, ${name}_real measurement)
{
    const ${name}_real re = c->filtered_re, im = c->filtered_im, before = c->filter_input;
    const ${name}_real now = measurement - c->filter_origin;
    c->filter_input = now;
    c->filtered_re = (${name}_real)${measurement_decay_re} * re - (${name}_real)${measurement_decay_im} * im
                     + (${name}_real)${measurement_from_last_re} * before + (${name}_real)${measurement_from_new_re} * now;
    c->filtered_im = (${name}_real)${measurement_decay_im} * re + (${name}_real)${measurement_decay_re} * im
                     + (${name}_real)${measurement_from_last_im} * before + (${name}_real)${measurement_from_new_im} * now;
    return c->filter_origin + c->filtered_re;
}

/* One tick: the control until the next. Inputs that are not finite make it a hold. */
static inline ${name}_real ${name}_step(${name}_state *c, ${name}_real setpoint, ${name}_real measurement,
                                        ${name}_real feedforward, ${name}_real manual)
{
    const ${name}_real before = c->proportional + c->derivative + c->feedforward;
    const ${name}_real step = (${name}_real)${setpoint_step}, deadband = (${name}_real)${deadband};
    const int begun = c->started;
    ${name}_real error, asked, changing, integrated, wanted;
    ${name}_real excess = c->control - c->remembered; /* limited less unlimited control at the last tick */

    if (!${name}_usable(setpoint) || !${name}_usable(measurement) || !${name}_usable(feedforward) || !${name}_usable(manual))
        return ${name}_hold(c, c->control);
    feedforward = ${name}_within(feedforward, c->control_min - c->control_max, c->control_max - c->control_min);
    if (!c->started) {
        c->started = 1;
        c->origin = c->setpoint = measurement;
        excess = 0;
    }
    if (${filtered}) {
        if (!begun || c->held) { /* at rest there */
            c->filter_origin = measurement;
            c->filtered_re = c->filtered_im = c->filter_input = 0;
        }
        measurement = ${name}_filter(c, measurement);
    }
    setpoint = ${name}_within(setpoint, c->setpoint - step, c->setpoint + step);

    if (c->manual || !(${takes_in}))
        excess = 0;
    if (${conditioned} && excess != 0)
        ${name}_correct(c, excess * (${name}_real)${error_per_excess});
    error = setpoint - measurement;
    error -= ${name}_within(error, -deadband, deadband);
    asked = setpoint - c->origin;
    changing = (${name}_real)${derivative_setpoint_weight} * asked - (measurement - c->origin) - c->shift;
    if (c->held) {
        c->shift += changing - c->differentiated;
        changing = c->differentiated;
    }
    c->differentiated = changing;
    integrated = c->manual ? 0 : error;
    if (!${conditioned})
        integrated += (${name}_real)${tracking_gain} * excess;
    ${name}_carry_on(c, integrated, changing);
    c->proportional = (${name}_real)${kp} * (error - (${name}_real)${off_proportional} * asked);
    if (c->held) {
        ${name}_owe(c, before - c->proportional - c->derivative - feedforward);
        c->held = 0;
    }
    if (${integrates})
        c->owed = c->ticks_to_pay = 0;
    if (c->ticks_to_pay > 0) {
        ${name}_owe(c, -c->owed / c->ticks_to_pay);
        c->ticks_to_pay -= 1;
    }
    c->setpoint = setpoint;
    c->last_error = error;
    c->feedforward = feedforward;
    wanted = c->manual ? manual : c->proportional + c->integral + c->derivative + feedforward;
    c->control = ${name}_limit(c, wanted);
    c->remembered = c->manual ? c->control : wanted;
    return c->control;
}

#endif

#ifdef ${NAME}_EXAMPLE
#include <stdio.h>

int main(void)
{
    static ${name}_state loop;
    double measurement = 0.0;
    int k;
    ${name}_init(&loop);
    for (k = 0; k < 2000; k++) {
        const double control = (double)${name}_step(&loop, 1, (${name}_real)measurement, 0, 0);
        if (k % 200 == 0)
            printf("%g s: measurement %g, control %g\n", k * ${sample_time}, measurement, control);
        measurement += ${sample_time} * (control - measurement);
    }
    return 0;
}
#endif
