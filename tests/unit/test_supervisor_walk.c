/*
 * A random walk of the whole firmware on the mocked board: hosts that talk and fall silent, right
 * and wrong commands, late ticks, a stalling main loop, an IMU and a battery in every mood, flash
 * that fails, restarts. A model of its own (walk_model.h) judges every tick, pass and answer.
 *
 * WALK_STEPS and WALK_SEED say how far and which way, where there is an environment.
 */
#include "target.h"
#include "walk_commands.h"

#define STEPS 100000u
#define STEPS_ON_TARGET 1500u
#define STEPS_THAT_COVER 100000u
#define SEED 20u

typedef enum { IN_IDLE, IN_ARMED, IN_RUNNING, IN_SETTLING, IN_HALT, COLUMNS } column_t;

typedef struct {
    const char *name;
    void (*happen)(void);
    uint16_t weight[COLUMNS];
} happening_t;

static uint64_t seed, step;
static uint32_t happened[64][STATE_COUNT];
static const char *now_happening = "boot";

void setUp(void) {}
void tearDown(void) {}

static void walk_failed(const char *what, int line) {
    static char text[400];
    (void)snprintf(
        text, sizeof text,
        "%s (line %d)\n  WALK_SEED=%llu, step %llu (%s), boot %lu at %llu us: board %s/%d, "
        "model %s/%d, tail %d, frame %lu, stop %d",
        what, line, (unsigned long long)seed, (unsigned long long)step, now_happening,
        (unsigned long)world.boots, (unsigned long long)hal.now_us,
        state_name(app.supervisor.state), app.supervisor.reason, state_name(model.state),
        model.reason, model.tail, (unsigned long)model.frame, model.stop);
    TEST_FAIL_MESSAGE(text);
}

/* The world. */

static void time_passes(void) { pass_time(1000u + draw(20000), PASS_US); }

static void time_passes_on(void) {
    const bool runs = model.state == STATE_RUNNING;
    pass_time(runs ? 20000u + draw(60000) : 50000u + draw(1000000), runs ? PASS_US : 50000u);
}

static void long_pause(void) { pass_time(500000u + draw(2500000), 100000u); }

static void late_tick(void) { world.tick_at_us += 1u + draw(chance(2) ? 5000u : 20000u); }

static void missing_ticks(void) {
    world.tick_due_us += TICK_US * (1u + draw(3));
    world.tick_at_us = world.tick_due_us;
}

static void main_loop_stalls(void) { world.pass_at_us += 1000u + draw(100000); }

static void hosts_change(void) {
    const uint32_t host = draw(HOSTS);
    world.talks[host] = !world.talks[host];
}

static void all_fall_silent(void) { memset(world.talks, 0, sizeof world.talks); }

static void imu_changes(void) { world.imu = (imu_mood_t)draw(5); }

static void battery_sags(void) {
    hal.battery_mv = (uint16_t)(5000u + draw(1500));
    world.sag_until_us = hal.now_us + 1000u + draw(chance(2) ? 100000 : 1500000);
}

static void battery_changes(void) {
    static const uint16_t MV[] = {0, 5500, 5999, 6000, 6599, 6600, 6799, 6800, 7199, 7400};
    hal.battery_mv = MV[draw(10)];
    world.sag_until_us = 0;
}

static void camera_sees(void) {
    const float speed[] = {0.04f, 0.02f, 0.06f, -0.01f, NAN, INFINITY, 1e30f, 0.0f};
    for (int i = 0; i < 8; i++) {
        const link_vision_t sample = {.time_us = hal.now_us - draw(600000),
                                      .speed_m_s = speed[chance(4) ? draw(8) : draw(3)],
                                      .sigma_m_s = chance(4) ? NAN : 0.001f};
        app.link.handlers.vision(app.link.handlers.context, &sample);
    }
}

static void restarts(void) {
    const hal_reset_cause_t cause[] = {HAL_RESET_POWER, HAL_RESET_WATCHDOG, HAL_RESET_PIN,
                                       HAL_RESET_SOFTWARE};
    hal.crashed = chance(6);
    hal.clock_inexact = chance(10);
    boot(cause[draw(4)]);
}

static void arm_by_any(void) { (void)arm(any_host()); }

static void power_cycle(void) {
    hal.crashed = hal.clock_inexact = false;
    boot(HAL_RESET_POWER);
}

static void overcome(fault_t refusal) {
    switch (refusal) {
    case FAULT_NONE:
        return;
    case FAULT_NO_REFERENCE:
        upload();
        return;
    case FAULT_TRIAL_PENDING:
        learn();
        model.pending ? discard() : (void)0;
        return;
    case FAULT_SERVO_CONFIG:
    case FAULT_BAD_LAW:
        change_all_params();
        return;
    case FAULT_CLOCK:
        power_cycle();
        return;
    default:
        mend_board();
    }
}

/* What a patient operator does next. */
static void go_on(void) {
    switch (model.state) {
    case STATE_IDLE:
        overcome(arm(any_host()));
        return;
    case STATE_ARMED:
        start_right();
        if (value_of(PARAM_SPD_SOURCE) > 1.5f) {
            disarm_board();
            change_all_params();
        }
        return;
    case STATE_ABORTED:
    case STATE_FAULT:
        clear_halt();
        return;
    default:
        time_passes_on();
    }
}

/* idle, armed, running, settling, halted */
static const happening_t HAPPENING[] = {
    {"time passes", time_passes, {900, 700, 1200, 500, 500}},
    {"time passes on", time_passes_on, {5, 20, 300, 300, 10}},
    {"long pause", long_pause, {2, 4, 2, 20, 6}},
    {"go on", go_on, {60, 80, 150, 100, 60}},
    {"mend", mend_board, {60, 60, 6, 20, 50}},
    {"late tick", late_tick, {5, 6, 5, 8, 8}},
    {"missing ticks", missing_ticks, {5, 5, 1, 8, 8}},
    {"main loop stalls", main_loop_stalls, {10, 10, 40, 10, 10}},
    {"hosts change", hosts_change, {20, 20, 12, 8, 10}},
    {"all fall silent", all_fall_silent, {4, 20, 12, 8, 8}},
    {"IMU changes", imu_changes, {10, 10, 10, 8, 8}},
    {"battery sags", battery_sags, {5, 10, 25, 8, 8}},
    {"battery changes", battery_changes, {20, 20, 4, 8, 8}},
    {"flash fails", let_flash_fail, {1, 2, 1, 4, 5}},
    {"camera sees", camera_sees, {5, 5, 60, 20, 8}},
    {"restart", restarts, {1, 2, 2, 5, 5}},
    {"arm", arm_by_any, {40, 30, 5, 8, 10}},
    {"start", start_right, {5, 40, 3, 8, 8}},
    {"start wrong", start_wrong, {5, 100, 5, 8, 8}},
    {"abort", abort_trial, {5, 5, 3, 8, 8}},
    {"disarm", disarm_board, {5, 5, 2, 8, 8}},
    {"clear", clear_halt, {5, 5, 5, 8, 30}},
    {"learn", learn, {40, 4, 3, 8, 8}},
    {"discard", discard, {10, 4, 3, 8, 8}},
    {"restore best", restore_best, {8, 4, 2, 8, 8}},
    {"upload", upload, {8, 3, 2, 5, 5}},
    {"parameters", change_all_params, {4, 3, 2, 8, 8}},
    {"set parameter", set_param, {60, 4, 3, 8, 8}},
    {"save IMU", save_imu, {2, 3, 2, 8, 8}},
    {"reboot", ask_reboot, {1, 3, 2, 8, 5}},
};
#define HAPPENINGS (sizeof HAPPENING / sizeof HAPPENING[0])

static column_t column(void) {
    static const column_t OF[STATE_COUNT] = {
        [STATE_IDLE] = IN_IDLE,         [STATE_ARMED] = IN_ARMED,  [STATE_RUNNING] = IN_RUNNING,
        [STATE_SETTLING] = IN_SETTLING, [STATE_ABORTED] = IN_HALT, [STATE_FAULT] = IN_HALT,
    };
    return OF[model.state];
}

static void take_step(void) {
    uint32_t total = 0;
    for (size_t i = 0; i < HAPPENINGS; i++) {
        total += HAPPENING[i].weight[column()];
    }
    uint32_t at = draw(total);
    size_t which = 0;
    while (at >= HAPPENING[which].weight[column()]) {
        at -= HAPPENING[which++].weight[column()];
    }
    now_happening = HAPPENING[which].name;
    happened[which][model.state]++;
    HAPPENING[which].happen();
}

static uint64_t from_environment(const char *name, uint64_t otherwise) {
    const char *text = ON_TARGET ? NULL : getenv(name);
    return text == NULL ? otherwise : strtoull(text, NULL, 10);
}

static void begin_walk(void) {
    fixture_reset();
    memset(&world, 0, sizeof world);
    memset(&model, 0, sizeof model);
    params_reset(&model.saved_params);
    world.random = seed * 0x9E3779B97F4A7C15ull + 1u;
    mend_board();
    boot(HAL_RESET_POWER);
    (void)arm(HOST[0]); /* without a reference */
}

static void tell_figures(void) {
    printf(
        "WALK_SEED=%llu: %llu steps, %.0f s on the board, %lu boots, %llu passes, %llu ticks (%llu "
        "amid a pass, %llu with the tail off its centre), %lu trials, %lu of them whole\n",
        (unsigned long long)seed, (unsigned long long)step,
        world.boots_s + (double)hal.now_us * 1e-6, (unsigned long)world.boots,
        (unsigned long long)seen.passes, (unsigned long long)seen.ticks,
        (unsigned long long)seen.in_between, (unsigned long long)seen.moved_ticks,
        (unsigned long)seen.trials, (unsigned long)seen.whole);
    for (uint16_t row = 1; row < fault_count(); row++) {
        const fault_info_t *info = fault_row(row);
        const uint32_t stops = seen.stops[info->number], answers = seen.answers[info->number];
        if (stops + answers > 0) {
            printf("  %s %lu", info->name, (unsigned long)(stops + answers));
        }
    }
    printf("\n");
}

/* Every event in every state, every way from state to state, every reason, every refusal. */
static void expect_coverage(void) {
    for (size_t i = 0; i < HAPPENINGS; i++) {
        for (int state = STATE_IDLE; state < STATE_COUNT; state++) {
            TEST_ASSERT_TRUE_MESSAGE(state == STATE_LEARNING || happened[i][state] > 0,
                                     HAPPENING[i].name);
        }
    }
    static const state_t WAY[][2] = {
        {STATE_BOOT, STATE_IDLE},       {STATE_BOOT, STATE_FAULT},
        {STATE_IDLE, STATE_ARMED},      {STATE_ARMED, STATE_IDLE},
        {STATE_ARMED, STATE_RUNNING},   {STATE_RUNNING, STATE_SETTLING},
        {STATE_RUNNING, STATE_ABORTED}, {STATE_RUNNING, STATE_FAULT},
        {STATE_SETTLING, STATE_IDLE},   {STATE_SETTLING, STATE_FAULT},
        {STATE_ABORTED, STATE_IDLE},    {STATE_ABORTED, STATE_FAULT},
        {STATE_FAULT, STATE_IDLE},
    };
    for (size_t i = 0; i < sizeof WAY / sizeof WAY[0]; i++) {
        TEST_ASSERT_TRUE_MESSAGE(seen.from_to[WAY[i][0]][WAY[i][1]] > 0, state_name(WAY[i][0]));
    }
    static const fault_t STOP[] = {FAULT_ABORT_COMMAND, FAULT_LINK_LOST, FAULT_IMU_STALE,
                                   FAULT_TILT,          FAULT_WATCHDOG,  FAULT_CRASH,
                                   FAULT_CLOCK,         FAULT_STORAGE,   FAULT_BATTERY_CRITICAL,
                                   FAULT_LATE_TICK,     FAULT_WALL,      FAULT_ERROR_LIMIT};
    for (size_t i = 0; i < sizeof STOP / sizeof STOP[0]; i++) {
        TEST_ASSERT_TRUE_MESSAGE(seen.stops[STOP[i]] > 0, fault_info(STOP[i])->name);
    }
    static const fault_t REFUSAL[] = {
        FAULT_WRONG_STATE, FAULT_NO_REFERENCE,  FAULT_BATTERY_LOW,   FAULT_TRIAL_NUMBER,
        FAULT_OTHER_HOST,  FAULT_STALE_COMMAND, FAULT_TRIAL_PENDING, FAULT_NO_TRIAL,
        FAULT_NO_BEST,     FAULT_STORAGE,       FAULT_SERVO_CONFIG,  FAULT_BAD_LAW,
        FAULT_CLOCK,       FAULT_BAD_PARAM,     FAULT_NO_IMU,        FAULT_NOTHING_MEASURED};
    for (size_t i = 0; i < sizeof REFUSAL / sizeof REFUSAL[0]; i++) {
        TEST_ASSERT_TRUE_MESSAGE(seen.answers[REFUSAL[i]] > 0, fault_info(REFUSAL[i])->name);
    }
}

static void a_random_walk_keeps_every_promise(void) {
    const uint64_t steps = from_environment("WALK_STEPS", ON_TARGET ? STEPS_ON_TARGET : STEPS);
    seed = from_environment("WALK_SEED", SEED);
    begin_walk();
    for (step = 0; step < steps; step++) {
        take_step();
    }
    tell_figures();
    TEST_ASSERT_TRUE(seen.trials > 0 && seen.moved_ticks > 0 && seen.in_between > 0);
    if (steps >= STEPS_THAT_COVER) {
        expect_coverage();
    }
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(a_random_walk_keeps_every_promise);
    return UNITY_END();
}
