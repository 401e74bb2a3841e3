/* Test vectors of ${name}.h: what the controller did on the machine that wrote it.
 *
 *   cc -std=c99 ${name}_test.c -o ${name}_test && ./${name}_test
 *
 * Exit status 0: every control agrees. Define ${NAME}_REAL as float for the numbers of a small processor.
 */
#include "${name}.h"
#include <stdio.h>

enum call { STEP, HOLD, MANUAL, LIMITS, RESET };

static const struct {
    enum call call;
    double a, b, c, d; /* arguments */
    double control;    /* afterwards */
} ticks[] = {
${rows}
};

int main(void)
{
    static ${name}_state loop;
    const double allowed = (sizeof(${name}_real) < sizeof(double) ? 1e-3 : 1e-8) * ${scale};
    const int count = (int)(sizeof ticks / sizeof ticks[0]);
    double worst = 0.0;
    int k;
    ${name}_init(&loop);
    for (k = 0; k < count; k++) {
        const ${name}_real a = (${name}_real)ticks[k].a, b = (${name}_real)ticks[k].b;
        const ${name}_real c = (${name}_real)ticks[k].c, d = (${name}_real)ticks[k].d;
        double off;
        switch (ticks[k].call) {
        case STEP: ${name}_step(&loop, a, b, c, d); break;
        case HOLD: ${name}_hold(&loop, a); break;
        case MANUAL: ${name}_set_manual(&loop, a != 0); break;
        case LIMITS: ${name}_set_limits(&loop, a, b, c); break;
        case RESET: ${name}_reset(&loop); break;
        }
        off = (double)loop.control - ticks[k].control;
        if (off < 0)
            off = -off;
        if (!(off <= allowed)) {
            printf("call %d: control %.17g instead of %.17g\n", k, (double)loop.control, ticks[k].control);
            return 1;
        }
        if (off > worst)
            worst = off;
    }
    printf("%d calls, largest difference %g\n", count, worst);
    return 0;
}
