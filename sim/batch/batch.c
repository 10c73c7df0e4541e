#include "batch.h"

#include "batch_lanes.h"
#include "common/noise.h"
#include "config_valid.h"
#include "fish/tail.h"
#include "water/disturbance.h"
#include "water/drag_step.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

/* Of a picture period, as the camera's. */
#define EXPOSURE_PHASE 0.33
#define COVERAGE_MIN 0.6
#define FRAME_US 20000u
#define RIPPLE_MAX 2.0
#define ROUNDING 1e-6 /* more than that of all that has been computed */
#define ALONE_MAX 2u  /* so many fish are faster one after the other than in a block */

static const double still[SUBSTEPS] = {1, 1, 1, 1};

/* What the whole call shares. */
typedef struct {
    const batch_lanes_t *lanes;
    const sim_config_t *configs;
    const uint32_t *swims;
    const double *amplitude_rad;
    size_t beats;
    double beat_s;
    double *true_m_s, *speed_m_s, *sigma_m_s;
    const tail_t *tail;
} task_t;

/* Fish |first| and the |count| - 1 after it. Lanes without a fish swim as the first. */
typedef struct {
    const task_t *task;
    size_t first, count;
    double fps; /* 0 = no pictures are wanted */
    uint64_t picture, frame, next_beat;
    uint64_t picture_us; /* when the next picture is taken; UINT64_MAX = none */
    bool alone;          /* one fish, by the plant's own code; otherwise all lanes at once */
    tail_t tail;
    plant_t plant;
    double way_m; /* since the beat began, alone in another plant than the tank */
    disturbance_t drawn[BATCH_LANES];
    bool moves;                  /* the water of any lane, within the trial */
    double moved_m[BATCH_LANES]; /* by that, since the beat began */
    batch_block_t rows;
} block_t;

/* Too much for the stack of a thread. The ring follows it. */
typedef struct {
    void *memory; /* from malloc; what lies here is aligned */
    task_t task;
    tail_t tail;
    block_t block;
} work_t;

static size_t fish_of(const block_t *block, unsigned lane) {
    return block->first + (lane < block->count ? lane : 0);
}

static bool has_servo(const sim_config_t *c) {
    return c->servo_lag_s > 0 || c->servo_rate_rad_s > 0;
}

static double drag_way_m(const batch_block_t *rows, unsigned lane) {
    return drag_way(rows->sum_m_s[lane], rows->v_m_s[lane], rows->frame_s / SUBSTEPS,
                    rows->twelfth[lane]);
}

static void set_water(block_t *block, unsigned l, const sim_config_t *c, uint32_t swim) {
    batch_block_t *rows = &block->rows;
    disturbance_draw(&block->drawn[l], c, swim);
    const double gain = block->drawn[l].gain;
    const double h = rows->frame_s / SUBSTEPS;
    rows->v_m_s[l] = block->drawn[l].start_m_s;
    rows->flow_m_s[l] = block->drawn[l].flow_m_s;
    block->moves = block->moves || block->drawn[l].moves;
    rows->kt[l] = c->kappa_per_m * h;
    rows->twice_kt[l] = 2 * rows->kt[l];
    rows->kt_fifteenth[l] = rows->kt[l] * (1.0 / 15.0);
    rows->twelfth[l] = drag_twelfth(rows->kt[l], h);
    rows->half_slope[l] = 0.5 * (gain * c->slope_m_s_rad);
    rows->quarter_bend[l] = 0.25 * (gain * c->map_bend_m_s_rad2);
    rows->twice_dead_zone_rad[l] = 2 * c->dead_zone_rad;
    rows->delay_steps[l] = tank_delay(c->delay_s, &rows->delay_fraction[l]);
    const tail_servo_t servo = tail_servo(c->servo_lag_s, c->servo_rate_rad_s, rows->frame_s);
    rows->settle[l] = servo.settle;
    rows->ahead_frames[l] = servo.ahead_frames;
    rows->most_rad[l] = servo.most_rad;
    rows->servo_rad[l] = rows->late[l] = 0;
    rows->late_most[l] = rows->v_m_s[l] * rows->v_m_s[l] / RIPPLE_MAX;
    rows->ahead[l] = cos(block->drawn[l].place_rad);
    rows->swayed_m[0][l] = rows->swayed_m[1][l] = 0;
    rows->sway_m_per_rad[l] =
        c->plant == SIM_PLANT_REACTIVE ? 0 : SWAY_M_PER_RAD * sin(block->drawn[l].place_rad);
    rows->sways = rows->sways || c->place_sigma_rad > 0;
    rows->bends = rows->bends || fabs(rows->quarter_bend[l]) > 0;
}

static void set_camera(batch_block_t *rows, unsigned l, const sim_config_t *c, uint32_t swim) {
    rows->noise_m[l] = c->camera_noise_m;
    rows->noise_key[l] = noise_key(c->seed, NOISE_CAMERA, swim);
    rows->lost_key[l] = noise_key(c->seed, NOISE_LOST, swim);
    rows->lost_below[l] = (uint64_t)ceil(c->camera_lost * 0x1p53);
    rows->lossy = rows->lossy || rows->lost_below[l] > 0;
}

static uint64_t next_picture_us(const block_t *block) {
    const double periods = (double)block->picture + EXPOSURE_PHASE;
    return block->fps > 0 ? (uint64_t)(periods * 1e6 / block->fps) : UINT64_MAX;
}

static void set_windows(block_t *block) {
    batch_block_t *rows = &block->rows;
    const double periods = floor(block->task->beat_s * block->fps + 0.5);
    rows->pictures_per_window = (uint32_t)periods + 1;
    rows->pictures_min = (uint32_t)fmax(3, ceil(COVERAGE_MIN * (periods + 1)));
    rows->half_window_s = block->fps > 0 ? 0.5 * periods / block->fps : 0;
    rows->window[0].open = rows->window[1].open = false;
    block->picture = block->frame = block->next_beat = 0;
    if (rows->pictures_per_window < 3) {
        block->fps = 0;
    }
    block->picture_us = next_picture_us(block);
}

/* Of a ring that remembers so many substeps. */
static uint64_t mask_for(uint64_t delay_steps) {
    uint64_t mask = 7;
    while (mask + 1 < delay_steps + SUBSTEPS) {
        mask = 2 * mask + 1;
    }
    return mask;
}

static size_t ring_bytes(uint64_t mask) { return (size_t)(mask + 1) * sizeof(batch_row_t); }

static void clear_thrust(batch_block_t *rows) {
    uint64_t longest = 0;
    rows->same_delay = rows->whole_delay = true;
    for (unsigned l = 0; l < BATCH_LANES; l++) {
        longest = rows->delay_steps[l] > longest ? rows->delay_steps[l] : longest;
        rows->same_delay = rows->same_delay && rows->delay_steps[l] == rows->delay_steps[0];
        rows->whole_delay = rows->whole_delay && !(rows->delay_fraction[l] > 0);
    }
    rows->ring_mask = mask_for(longest);
    memset(rows->thrust, 0, ring_bytes(rows->ring_mask));
}

static void begin(block_t *block) {
    const task_t *task = block->task;
    batch_block_t *rows = &block->rows;
    rows->frame_s = task->beat_s / task->tail->frames_per_beat;
    rows->omega_rad_s = task->tail->omega_rad_s;
    rows->has_servo = has_servo(&task->configs[block->first]);
    rows->lossy = false;
    rows->step = 0;
    block->moves = rows->sways = rows->bends = false;
    for (unsigned l = 0; l < BATCH_LANES; l++) {
        const size_t fish = fish_of(block, l);
        set_water(block, l, &task->configs[fish], task->swims[fish]);
        set_camera(rows, l, &task->configs[fish], task->swims[fish]);
    }
    clear_thrust(rows);
    set_windows(block);
}

/* Of a fish whose path is no line: along its heading. Nobody has trimmed its tail. */
static void frame_reactive(block_t *block, const drive_t *drive) {
    batch_block_t *rows = &block->rows;
    plant_t *plant = &block->plant;
    const double way_m = block->way_m;
    const double ahead = plant->motion.cosine, aside = plant->motion.sine;
    plant_frame(plant, drive, block->task->configs[block->first].tail_centre_rad, rows->frame_s);
    const plant_point_t *trace = plant->motion.trace;
    for (unsigned i = 0; i <= SUBSTEPS; i++) {
        rows->trace_v_m_s[i][0] = trace[i].vx_m_s * ahead + trace[i].vy_m_s * aside;
        rows->trace_way_m[i][0] =
            way_m + (trace[i].x_m - trace[0].x_m) * ahead + (trace[i].y_m - trace[0].y_m) * aside;
    }
    block->way_m = rows->trace_way_m[SUBSTEPS][0];
}

/* Over water since the beat began. */
static double lane_way_m(const block_t *block, unsigned lane) {
    const batch_block_t *rows = &block->rows;
    const bool tank = !block->alone || block->plant.kind == SIM_PLANT_TANK;
    return tank ? drag_way_m(rows, lane) - rows->begin_m[lane] : block->way_m;
}

/* The frame of the fish that swims alone. */
static void frame_alone(block_t *block, bool limp) {
    batch_block_t *rows = &block->rows;
    plant_t *plant = &block->plant;
    const double dt = rows->frame_s / SUBSTEPS;
    drive_t drive = {{0, 0, 0, 0}, {1, 1, 1, 1}, {1, 1, 1, 1}, {0, 0}};
    if (!limp || block->tail.has_servo) {
        tail_frame_sine(&block->tail, rows->amplitude_rad[0], rows->frame_s, &drive);
    }
    if (plant->kind == SIM_PLANT_REACTIVE) {
        frame_reactive(block, &drive);
        return;
    }
    rows->trace_v_m_s[0][0] = rows->v_m_s[0];
    rows->trace_way_m[0][0] = lane_way_m(block, 0);
    for (unsigned i = 0; i < SUBSTEPS; i++) {
        double *v = &rows->v_m_s[0];
        if (plant->kind == SIM_PLANT_TANK) {
            rows->sum_m_s[0] += tank_sum_step(&plant->tank, v, &drive, i, plant->gain, dt);
        } else {
            block->way_m += thesis_step(&plant->thesis, v, drive.amplitude_rad[i], plant->gain, dt);
        }
        rows->trace_v_m_s[i + 1][0] = *v;
        rows->trace_way_m[i + 1][0] = lane_way_m(block, 0);
    }
}

static void store_fit(block_t *block, batch_window_t *window) {
    const task_t *task = block->task;
    task->lanes->fit(&block->rows, window);
    for (unsigned l = 0; l < block->count; l++) {
        const size_t at = (block->first + l) * task->beats + (size_t)window->beat;
        const bool hidden = disturbance_hides(&block->drawn[l], window->beat);
        task->speed_m_s[at] = hidden ? (double)NAN : block->rows.speed_m_s[l];
        task->sigma_m_s[at] = hidden ? (double)NAN : block->rows.sigma_m_s[l];
    }
    window->open = false;
}

static void open_window(block_t *block, uint64_t beat, double time_s) {
    batch_window_t *window = &block->rows.window[beat & 1u];
    memset(window, 0, sizeof *window);
    window->open = true;
    window->beat = beat;
    window->begin_s = time_s;
    memcpy(window->offset_m, block->rows.base_m, sizeof window->offset_m);
}

static void take_picture(block_t *block, uint64_t time_us) {
    const uint64_t beat_us = (uint64_t)block->task->tail->frames_per_beat * FRAME_US;
    const uint64_t beat = time_us / beat_us;
    const double part = (double)(time_us % FRAME_US) / FRAME_US * SUBSTEPS;
    const batch_picture_t picture = {
        .sample = block->picture,
        .time_s = (double)time_us * 1e-6,
        .in_beat_s = (double)(time_us - beat * beat_us) * 1e-6,
        .substep = (unsigned)part,
        .part = part - (unsigned)part,
    };
    batch_window_t *window = block->rows.window;
    if (beat >= block->next_beat && beat < block->task->beats) {
        open_window(block, beat, picture.time_s);
        block->next_beat = beat + 1;
    }
    block->task->lanes->picture(&block->rows, &picture);
    for (unsigned i = 0; i < 2; i++) {
        if (window[i].open && ++window[i].taken == block->rows.pictures_per_window) {
            store_fit(block, &window[i]);
        }
    }
}

/* The pictures out of the last frame. */
static void look(block_t *block) {
    const uint64_t end_us = ++block->frame * FRAME_US;
    while (block->picture_us < end_us) {
        take_picture(block, block->picture_us);
        block->picture++;
        block->picture_us = next_picture_us(block);
    }
}

/* The moving part of the flow, in the frame that has just been computed: held for that frame, as
 * the world holds it. */
static void move_water(block_t *block) {
    batch_block_t *rows = &block->rows;
    const double since_s = (double)block->frame * rows->frame_s;
    for (unsigned l = 0; l < block->count; l++) {
        const double begin_m = rows->base_m[l] + rows->trace_way_m[0][l] + block->moved_m[l] +
                               rows->flow_m_s[l] * fmod(since_s, block->task->beat_s);
        const double by_m_s = disturbance_flow_m_s(&block->drawn[l], since_s, begin_m);
        for (unsigned i = 0; i <= SUBSTEPS; i++) {
            rows->trace_v_m_s[i][l] += by_m_s;
            rows->trace_way_m[i][l] += block->moved_m[l] + by_m_s * rows->frame_s * i / SUBSTEPS;
        }
        block->moved_m[l] += by_m_s * rows->frame_s;
    }
}

/* What the lanes do for the others. */
static void sway_alone(block_t *block, double sine) {
    batch_block_t *rows = &block->rows;
    const double tail_rad = rows->has_servo ? block->tail.servo_rad : rows->amplitude_rad[0] * sine;
    rows->swayed_m[0][0] = rows->swayed_m[1][0];
    rows->swayed_m[1][0] = rows->sway_m_per_rad[0] * tail_rad;
}

/* The points of this frame, as bits, that somebody looks at. */
static uint32_t points_seen(const block_t *block) {
    const uint64_t into_us = block->picture_us - block->frame * FRAME_US;
    const bool seen = into_us < FRAME_US;
    if (block->moves || (seen && block->fps >= 1e6 / FRAME_US)) {
        return (1u << (SUBSTEPS + 1)) - 1;
    }
    return seen ? 3u << into_us / (FRAME_US / SUBSTEPS) : 0;
}

static void swim_frame(block_t *block, uint32_t frame, bool limp) {
    const tail_t *tail = block->task->tail;
    const double *sine = tail->sine + frame;
    block->rows.traced = points_seen(block);
    if (block->alone) {
        frame_alone(block, limp);
        sway_alone(block, sine[1]);
    } else {
        block->task->lanes->frame(&block->rows, sine[0], sine[1],
                                  limp ? still : tail->ripple + frame * SUBSTEPS);
    }
    if (block->moves) {
        move_water(block);
    }
    look(block);
}

static void begin_beat(block_t *block, size_t beat) {
    batch_block_t *rows = &block->rows;
    const task_t *task = block->task;
    for (unsigned l = 0; l < BATCH_LANES; l++) {
        rows->base_m[l] = beat == 0 ? 0
                                    : rows->base_m[l] + lane_way_m(block, l) + block->moved_m[l] +
                                          rows->flow_m_s[l] * task->beat_s;
        rows->sum_m_s[l] = block->moved_m[l] = 0;
        rows->begin_m[l] = drag_way_m(rows, l);
        rows->amplitude_rad[l] =
            beat < task->beats ? fabs(task->amplitude_rad[fish_of(block, l) * task->beats + beat])
                               : 0;
    }
    block->way_m = 0;
}

static void swim_beats(block_t *block) {
    const task_t *task = block->task;
    const uint32_t frames = task->tail->frames_per_beat;
    for (size_t k = 0; k < task->beats; k++) {
        begin_beat(block, k);
        for (uint32_t i = 0; i < frames; i++) {
            swim_frame(block, i, false);
        }
        for (unsigned l = 0; l < block->count; l++) {
            task->true_m_s[(block->first + l) * task->beats + k] =
                (lane_way_m(block, l) + block->moved_m[l]) / task->beat_s + block->rows.flow_m_s[l];
        }
    }
    /* The last beat's window closes a picture later, with the tail limp. */
    begin_beat(block, task->beats);
    for (uint32_t i = 0; i < frames && (block->rows.window[0].open || block->rows.window[1].open);
         i++) {
        swim_frame(block, i, true);
    }
}

static void fill_unmeasured(const block_t *block) {
    const task_t *task = block->task;
    if (task->speed_m_s == NULL) {
        return;
    }
    const size_t begin = block->first * task->beats;
    for (size_t i = begin; i < begin + block->count * task->beats; i++) {
        task->speed_m_s[i] = task->sigma_m_s[i] = (double)NAN;
    }
}

static void swim_block(block_t *block) {
    const task_t *task = block->task;
    block->fps = task->speed_m_s != NULL ? task->configs[block->first].camera_fps : 0;
    begin(block);
    fill_unmeasured(block);
    swim_beats(block);
}

/* By the simulator's own code, for what the lanes cannot do. */
static void swim_alone(block_t *block, size_t fish) {
    const task_t *task = block->task;
    sim_config_t timed = task->configs[fish];
    timed.beat_s = task->beat_s;
    tail_init(&block->tail, &timed, task->tail->frames_per_beat);
    plant_init(&block->plant, &timed);
    disturbance_t drawn;
    disturbance_draw(&drawn, &timed, task->swims[fish]);
    plant_begin(&block->plant, drawn.start_m_s, drawn.gain, 0);
    block->first = fish;
    block->count = 1;
    block->alone = true;
    swim_block(block);
    block->alone = false;
}

static bool alike(const sim_config_t *a, const sim_config_t *b) {
    return a->plant == SIM_PLANT_TANK && b->plant == SIM_PLANT_TANK &&
           has_servo(a) == has_servo(b) && a->camera_fps >= b->camera_fps &&
           a->camera_fps <= b->camera_fps;
}

/* Whether drag_step took its fraction in every step of lane |l|. The fish was never faster than at
 * its begin, or than it would have settled at: one limit holds for its speed and for its thrust. */
static bool all_in_fraction(const batch_block_t *rows, unsigned l) {
    return RIPPLE_MAX * rows->late_most[l] * rows->kt[l] * rows->kt[l] <
           (1 - ROUNDING) * DRAG_FRACTION_MOST * DRAG_FRACTION_MOST;
}

/* Returns how many fish it took. */
static size_t swim_some(block_t *block, size_t first, size_t fish) {
    const task_t *task = block->task;
    size_t count = 0;
    while (count < BATCH_LANES && first + count < fish &&
           alike(&task->configs[first], &task->configs[first + count])) {
        count++;
    }
    if (count <= ALONE_MAX) {
        swim_alone(block, first);
        return 1;
    }
    block->first = first;
    block->count = count;
    swim_block(block);
    uint64_t wrong = 0;
    for (unsigned l = 0; l < count; l++) {
        wrong |= all_in_fraction(&block->rows, l) ? 0 : (uint64_t)1 << l;
    }
    for (unsigned l = 0; l < count; l++) {
        if ((wrong >> l & 1u) != 0) {
            swim_alone(block, first + l);
        }
    }
    return count;
}

static bool valid(const task_t *task, size_t fish) {
    for (size_t i = 0; i < fish; i++) {
        if (!sim_config_valid(&task->configs[i])) {
            return false;
        }
    }
    for (size_t i = 0; i < fish * task->beats; i++) {
        if (!isfinite(task->amplitude_rad[i])) {
            return false;
        }
    }
    return (task->speed_m_s == NULL) == (task->sigma_m_s == NULL);
}

static uint64_t longest_delay(const sim_config_t *configs, size_t fish) {
    double longest_s = 0, fraction;
    for (size_t i = 0; i < fish; i++) {
        longest_s = fmax(longest_s, configs[i].delay_s);
    }
    return tank_delay(longest_s, &fraction);
}

/* NULL without memory. */
static work_t *new_work(const task_t *task, size_t fish) {
    const size_t ring = ring_bytes(mask_for(longest_delay(task->configs, fish)));
    /* Windows has no aligned_alloc. */
    char *memory = malloc(_Alignof(work_t) + sizeof(work_t) + ring);
    work_t *work = NULL;
    if (memory != NULL) {
        work = (work_t *)(memory + _Alignof(work_t) - (uintptr_t)memory % _Alignof(work_t));
        memset(work, 0, sizeof *work);
        work->memory = memory;
        work->task = *task;
        work->task.tail = &work->tail;
        work->block.task = &work->task;
        work->block.rows.thrust = (batch_row_t *)(work + 1);
    }
    return work;
}

bool batch_swim_on(const batch_lanes_t *lanes, const sim_config_t *configs, size_t fish,
                   const uint32_t *swims, const double *amplitude_rad, size_t beats, double beat_s,
                   double *true_m_s, double *speed_m_s, double *sigma_m_s) {
    const uint32_t frames = tail_beat_frames(beat_s);
    const task_t task = {.lanes = lanes,
                         .configs = configs,
                         .swims = swims,
                         .amplitude_rad = amplitude_rad,
                         .beats = beats,
                         .beat_s = beat_s,
                         .true_m_s = true_m_s,
                         .speed_m_s = speed_m_s,
                         .sigma_m_s = sigma_m_s};
    if (frames == 0 || !valid(&task, fish)) {
        return false;
    }
    if (fish == 0 || beats == 0) {
        return true;
    }
    work_t *work = new_work(&task, fish);
    if (work == NULL) {
        return false;
    }
    sim_config_t timed = configs[0];
    timed.beat_s = beat_s;
    tail_init(&work->tail, &timed, frames);
    for (size_t first = 0; first < fish;) {
        first += swim_some(&work->block, first, fish);
    }
    free(work->memory);
    return true;
}

bool batch_swim(const sim_config_t *configs, size_t fish, const uint32_t *swims,
                const double *amplitude_rad, size_t beats, double beat_s, double *true_m_s,
                double *speed_m_s, double *sigma_m_s) {
    const batch_lanes_t *best = batch_lanes(0);
    for (size_t i = 1; batch_lanes(i) != NULL; i++) {
        best = batch_lanes(i);
    }
    return batch_swim_on(best, configs, fish, swims, amplitude_rad, beats, beat_s, true_m_s,
                         speed_m_s, sigma_m_s);
}
