/* How fast this processor divides and takes roots: what no simulation of many fish gets past. */
#ifndef BENCH_DIVIDER_H
#define BENCH_DIVIDER_H

/* Seconds of processor time for a quotient and a root, by vector register, over its lanes: a
 * substep of one fish. */
double divider_substep_s(void);

#endif
