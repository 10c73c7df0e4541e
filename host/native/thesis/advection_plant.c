#include "advection_plant.h"

#include <math.h>
#include <stdbool.h>
#include <stddef.h>
#include <string.h>

#define NODES_MAX (ADVECTION_CELLS_MAX + 1u)
#define NEWTON_MAX 50u
#define NEWTON_MOVES 1e-10

/* What one sample is computed with: rows of the tridiagonal system of a Newton step. */
typedef struct {
    double lower[NODES_MAX], middle[NODES_MAX], upper[NODES_MAX], rest[NODES_MAX];
} rows_t;

/* A source in the middle of a cell and how it changes with v at the cell's two nodes. */
typedef struct {
    double value, by_left, by_right;
} source_t;

static double uptake(const advection_plant_t *plant, double v, double *slope) {
    const double mu = plant->uptake_max;
    const double k = plant->half_at;
    const bool clipped = plant->uptake == ADVECTION_CLIP && v <= 0;
    if (plant->uptake == ADVECTION_NONE || clipped) {
        *slope = 0;
        return 0;
    }
    const double below = k + (plant->uptake == ADVECTION_ABS ? fabs(v) : v);
    *slope = -mu * k / (below * below);
    return -mu * v / below;
}

static source_t source(const advection_plant_t *plant, uint32_t cell, double time, double left,
                       double right) {
    const double h = 1.0 / plant->cells;
    const double x = (cell + 0.5) * h;
    const double kept = -plant->carried * (time + x);
    const double moved = -plant->carried * (x * time + 0.5 * x * x) / h;
    double slope;
    const double taken = uptake(plant, 0.5 * (left + right), &slope);
    return (source_t){.value = kept * 0.5 * (left + right) + moved * (right - left) + taken,
                      .by_left = 0.5 * (kept + slope) - moved,
                      .by_right = 0.5 * (kept + slope) + moved};
}

/* Heat that a node holds, heat that has come since |old|, and the boundaries. */
static void begin_rows(const advection_plant_t *plant, const double *old, const double *v,
                       double input, rows_t *rows) {
    const double h = 1.0 / plant->cells;
    for (uint32_t j = 0; j <= plant->cells; j++) {
        const bool end = j == 0 || j == plant->cells;
        const double per_step = (end ? 0.5 : 1.0) * h / plant->step;
        rows->middle[j] = per_step;
        rows->rest[j] = per_step * (v[j] - old[j]);
    }
    rows->rest[0] += input;
    rows->rest[plant->cells] -= plant->inflow;
}

static void add_cells(const advection_plant_t *plant, const double *v, double time, rows_t *rows) {
    const double h = 1.0 / plant->cells;
    for (uint32_t j = 0; j < plant->cells; j++) {
        const source_t s = source(plant, j, time, v[j], v[j + 1]);
        const double flow = (v[j + 1] - v[j]) / h;
        rows->rest[j] -= flow + 0.5 * h * s.value;
        rows->rest[j + 1] += flow - 0.5 * h * s.value;
        rows->middle[j] += 1 / h - 0.5 * h * s.by_left;
        rows->middle[j + 1] += 1 / h - 0.5 * h * s.by_right;
        rows->upper[j] = -1 / h - 0.5 * h * s.by_right;
        rows->lower[j + 1] = -1 / h - 0.5 * h * s.by_left;
    }
}

/* Subtracts the solution from |v|; no pivots, the middle outweighs its neighbours. Returns the
 * largest move, over 1 + the largest |v|. */
static double solve(rows_t *rows, uint32_t cells, double *v) {
    double most = 0;
    double largest = 0;
    for (uint32_t j = 1; j <= cells; j++) {
        const double factor = rows->lower[j] / rows->middle[j - 1];
        rows->middle[j] -= factor * rows->upper[j - 1];
        rows->rest[j] -= factor * rows->rest[j - 1];
    }
    double after = 0;
    for (uint32_t j = cells + 1; j-- > 0;) {
        const double above = j < cells ? rows->upper[j] * after : 0;
        after = (rows->rest[j] - above) / rows->middle[j];
        v[j] -= after;
        most = fabs(after) <= most ? most : fabs(after); /* a NaN gets through */
        largest = fmax(largest, fabs(v[j]));
    }
    return most / (1 + largest);
}

static bool advance(const advection_plant_t *plant, double time, double input, double *v) {
    rows_t rows;
    double old[NODES_MAX];
    memcpy(old, v, (plant->cells + 1u) * sizeof *v);
    for (uint32_t i = 0; i < NEWTON_MAX; i++) {
        begin_rows(plant, old, v, input, &rows);
        add_cells(plant, v, time, &rows);
        const double moved = solve(&rows, plant->cells, v);
        if (moved < NEWTON_MOVES || !isfinite(moved)) {
            return isfinite(moved);
        }
    }
    return false;
}

static bool makes_sense(const advection_plant_t *plant) {
    return plant->cells >= 1u && plant->cells <= ADVECTION_CELLS_MAX && plant->step > 0 &&
           plant->half_at > 0 && (unsigned)plant->uptake <= ADVECTION_NONE;
}

uint32_t advection_plant_run(const advection_plant_t *plant, const double *input, double *output,
                             double *field) {
    double v[NODES_MAX] = {0};
    if (!makes_sense(plant)) {
        return 0;
    }
    const size_t nodes = plant->cells + 1u;
    for (uint32_t k = 0; k < plant->samples; k++) {
        if (k > 0 && !advance(plant, k * plant->step, input[k], v)) {
            return k;
        }
        output[k] = v[plant->cells];
        if (field != NULL) {
            memcpy(field + k * nodes, v, nodes * sizeof *v);
        }
    }
    return plant->samples;
}
