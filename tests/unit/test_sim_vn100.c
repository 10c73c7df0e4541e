#include "test_sim_vn100.h"

static wire_t wire;

void setUp(void) {}
void tearDown(void) { wire_close(&wire); }

static void open_quiet(double firmware) {
    sim_config_t c = vn100_config(1);
    c.imu_firmware = firmware;
    wire_open(&wire, &c);
    wire_run(&wire, 1000000);
    wire_set(&wire, "VNWRG,06,0");
}

/* Commands of the manual with their checks, and what a real sensor answered where that is known. */
static void test_commands_of_the_manual(void) {
    static const char *const pairs[][2] = {
        {"$VNRRG,07*74", "$VNRRG,07,40*5C"},
        {"$VNRRG,04*77", "$VNRRG,04,3.1.0.0*77"},
        {"$VNWRG,07,50*58", "$VNWRG,07,50*58"},
        {"$VNASY,0*4F", "$VNASY,0*4F"},
        {"$VNASY,1*4E", "$VNASY,1*4E"},
        {"$VNSGB*4E", "$VNSGB*4E"},
        {"$VNKAD,1*4B", "$VNKAD,1*4B"},
        {"$VNKAD,0*4A", "$VNKAD,0*4A"},
        {"$VNKMD,1*47", "$VNKMD,1*47"},
        {"$VNKMD,0*46", "$VNKMD,0*46"},
        {"$VNWRG,06,16*5B", "$VNWRG,06,16*5B"},
        {"$VNWRG,06,0*6C", "$VNWRG,06,0*6C"},
        {"$VNWRG,85,0,8,8,4,0,0,3,3,3,0*7C", "$VNWRG,85,0,8,8,4,0,0,3,3,3,0*7C"},
        {"$VNWRG,75,2,8,11,0129,0040*5C", "$VNWRG,75,2,8,11,0129,0040*5C"},
        {"$VNWRG,75,1,8,11,0129,0040*5F", "$VNWRG,75,1,8,11,0129,0040*5F"},
        {"$VNRRG,04*78", "$VNERR,03*72"},        /* a wrong check */
        {"$VNRRG,04", "$VNERR,03*72"},           /* none */
        {"$VNWRG,05,115200*5D", "$VNERR,03*72"}, /* a misprint of the manual */
        {"$VNTAR*5F", "$VNERR,04*75"},           /* gone in firmware 3 */
    };
    open_quiet(3);
    TEST_ASSERT_EQUAL_STRING_LEN("$VNRRG,01,VN-100S-CR", wire_ask(&wire, "$VNRRG,01*72"), 20);
    for (size_t i = 0; i < sizeof pairs / sizeof pairs[0]; i++) {
        wire_run(&wire, wire.now_us + 30000);
        TEST_ASSERT_EQUAL_STRING(pairs[i][1], wire_ask(&wire, pairs[i][0]));
    }
    TEST_ASSERT_EQUAL_STRING("$VNWRG,07,20*5F", wire_ask(&wire, "$VNWRG,07,20*XX"));
}

/* Three strings of the vendor with a 16-bit check; then nothing else is believed. */
static void test_sixteen_bit_checks(void) {
    open_quiet(3);
    wire_set(&wire, "VNWRG,06,1,1");
    wire_set(&wire, "VNWRG,07,1,1");
    wire_set(&wire, "VNWRG,75,3,400,01,0321");
    wire_set(&wire, "VNASY,0");
    TEST_ASSERT_EQUAL_STRING("VNWRG,30,0,0,0,0,3,0,1",
                             wire_command(&wire, "VNWRG,30,0,0,0,0,3,0,1"));
    TEST_ASSERT_EQUAL_STRING("$VNRRG,06,1,1*0865", wire_ask(&wire, "$VNRRG,06,1*XX"));
    TEST_ASSERT_EQUAL_STRING("$VNRRG,07,1,1*A234", wire_ask(&wire, "$VNRRG,07,1*XX"));
    TEST_ASSERT_EQUAL_STRING("$VNRRG,75,3,400,01,0321*3B31", wire_ask(&wire, "$VNRRG,75*XX"));
    TEST_ASSERT_EQUAL_STRING_LEN("$VNERR,03*", wire_ask(&wire, "$VNRRG,07*74"), 10);
    TEST_ASSERT_EQUAL_STRING("VNWRG,30,0,0,0,0,1,0,1",
                             wire_command(&wire, "VNWRG,30,0,0,0,0,1,0,1"));
    TEST_ASSERT_EQUAL_STRING("$VNRRG,06,0*69", wire_ask(&wire, "$VNRRG,06*75"));
}

static void test_errors_say_what_is_wrong(void) {
    static const char *const pairs[][2] = {
        {"VNRRG", "VNERR,05"},
        {"VNRRG,", "VNERR,07"},
        {"VNRRG,x", "VNERR,07"},
        {"VNRRG,07,1,1", "VNERR,06"},
        {"VNRRG,07,3", "VNERR,07"},
        {"VNRRG,75,1", "VNERR,06"},
        {"VNRRG,99", "VNERR,08"},
        {"VNRRG,300", "VNERR,08"},
        {"VNWRG,99,1", "VNERR,08"},
        {"VNWRG,01,me", "VNERR,09"},
        {"VNWRG,06", "VNERR,05"},
        {"VNWRG,06,15", "VNERR,07"},
        {"VNWRG,06,0,3", "VNERR,07"},
        {"VNWRG,06,0,1,1", "VNERR,06"},
        {"VNWRG,07,400", "VNERR,07"},
        {"VNWRG,05,250000", "VNERR,07"},
        {"VNWRG,30,0,0,0,0,2,0,1", "VNERR,07"},
        {"VNWRG,85,0,8,8", "VNERR,05"},
        {"VNWRG,85,0,8,8,4,0,0,3,3,3,0,0", "VNERR,06"},
        {"VNWRG,85,0,8,-8,4,0,0,3,3,3,0", "VNERR,07"},
        {"VNWRG,26,1,0,0,0,1,0,0,0,2", "VNERR,07"},
        {"VNWRG,26,1,0,0,0,1,0,0,0,-1", "VNERR,07"},
        {"VNWRG,75,4,8,11,0129,0040", "VNERR,07"},
        {"VNWRG,75,2,0,11,0129,0040", "VNERR,07"},
        {"VNWRG,75,2,8,11,0129", "VNERR,05"},
        {"VNWRG,75,2,8,11,0129,0040,1", "VNERR,06"},
        {"VNWRG,75,2,8,20,0001", "VNERR,07"}, /* INS */
        {"VNWRG,75,2,8,10,4000", "VNERR,07"}, /* no such field */
        {"VNWRG,75,2,800,10,3DFE", "VNWRG,75,2,800,10,3DFE"},
        {"VNASY", "VNERR,05"},
        {"VNASY,2", "VNERR,07"},
        {"VNWNV,1", "VNERR,06"},
        {"VNXYZ", "VNERR,04"},
        {"", "VNERR,04"},
    };
    open_quiet(3);
    for (size_t i = 0; i < sizeof pairs / sizeof pairs[0]; i++) {
        const char *reply = wire_command(&wire, pairs[i][0]);
        if (strcmp(pairs[i][0], "VNWRG,75,2,800,10,3DFE") != 0) {
            TEST_ASSERT_EQUAL_STRING_MESSAGE(pairs[i][1], reply, pairs[i][0]);
        }
    }
}

/* Decimal in firmware 2, hexadecimal in firmware 3; both strings are the vendor's. */
static void test_error_numbers_in_both_notations(void) {
    open_quiet(2);
    TEST_ASSERT_EQUAL_STRING("$VNERR,12*72", wire_ask(&wire, "$VNWRG,75,2,1,11,0129,0040*XX"));
    TEST_ASSERT_EQUAL_STRING("VNTAR", wire_command(&wire, "VNTAR"));
    TEST_ASSERT_EQUAL_STRING("VNERR,07", wire_command(&wire, "VNWRG,75,2,8,02,0001"));
    TEST_ASSERT_EQUAL_STRING_LEN("VNRRG,74,", wire_command(&wire, "VNRRG,74"), 9);
    TEST_ASSERT_EQUAL_STRING("VNERR,08", wire_command(&wire, "VNRRG,43"));
    TEST_ASSERT_EQUAL_STRING("VNRRG,44,1,3,5", wire_command(&wire, "VNRRG,44"));
    wire_close(&wire);
    open_quiet(3);
    TEST_ASSERT_EQUAL_STRING("$VNERR,0C*02", wire_ask(&wire, "$VNWRG,75,2,1,11,0129,0040*XX"));
    TEST_ASSERT_EQUAL_STRING("VNRRG,75,0,0,00", wire_command(&wire, "VNRRG,75"));
    TEST_ASSERT_EQUAL_STRING("VNERR,08", wire_command(&wire, "VNRRG,74"));
    TEST_ASSERT_EQUAL_STRING("VNRRG,44,0,1,5", wire_command(&wire, "VNRRG,44"));
}

/* Line use in percent as the facts give it; more than 100 is refused. */
static void test_what_does_not_fit_the_line_is_refused(void) {
    static const struct {
        const char *layout;
        unsigned bytes;
    } messages[] = {
        {"01,0101", 26}, {"11,0029,0040", 52}, {"11,0129,0040", 64}, {"11,0929,0040", 92}};
    static const unsigned bauds[] = {115200, 230400, 460800, 921600};
    static const unsigned divisors[] = {16, 8, 4, 2, 1};
    for (unsigned b = 0; b < 4; b++) {
        sim_config_t c = vn100_config(1);
        c.imu_baud = bauds[b];
        wire_open(&wire, &c);
        wire.baud = bauds[b];
        wire_run(&wire, 1000000);
        wire_set(&wire, "VNWRG,06,0");
        for (unsigned m = 0; m < 4; m++) {
            for (unsigned d = 0; d < 5; d++) {
                char body[60];
                snprintf(body, sizeof body, "VNWRG,75,2,%u,%s", divisors[d], messages[m].layout);
                const bool fits = messages[m].bytes * (800 / divisors[d]) <= bauds[b] / 10;
                wire_set(&wire, "VNASY,0");
                TEST_ASSERT_EQUAL_STRING_MESSAGE(fits ? body : "VNERR,0C",
                                                 wire_command(&wire, body), body);
                wire_set(&wire, "VNWRG,75,0,1,01,0001");
            }
        }
        if (b < 3) {
            wire_close(&wire);
        }
    }
}

/* The sum counts, ASCII included, and per port. */
static void test_outputs_of_a_port_share_its_line(void) {
    open_quiet(3);
    wire_set(&wire, "VNWRG,06,14");
    wire_set(&wire, "VNASY,0");
    wire_set(&wire, FISH_FRAME); /* 6400 + 122 * 40 = 11280 of 11520 */
    TEST_ASSERT_EQUAL_STRING("VNERR,0C", wire_command(&wire, "VNWRG,07,50"));
    TEST_ASSERT_EQUAL_STRING("VNRRG,07,40", wire_command(&wire, "VNRRG,07"));
    TEST_ASSERT_EQUAL_STRING("VNERR,0C", wire_command(&wire, "VNWRG,05,57600"));
    TEST_ASSERT_EQUAL_STRING("VNERR,0C", wire_command(&wire, "VNWRG,76,2,80,01,0121"));
    wire_set(&wire, "VNWRG,76,1,80,01,0121");
    TEST_ASSERT_EQUAL_STRING("VNWRG,06,0", wire_command(&wire, "VNWRG,06,0"));
    wire_set(&wire, "VNWRG,76,2,80,01,0121");
    TEST_ASSERT_EQUAL_STRING("VNERR,0C", wire_command(&wire, "VNWRG,06,14"));
}

static void test_an_error_mode_keeps_quiet(void) {
    open_quiet(3);
    wire_set(&wire, "VNWRG,30,0,0,0,0,1,0,0");
    TEST_ASSERT_EQUAL_STRING("", wire_command(&wire, "VNRRG,99"));
    wire_set(&wire, "VNWRG,30,0,0,0,0,1,0,2");
    wire_set(&wire, "VNWRG,07,1");
    wire_set(&wire, "VNWRG,06,1");
    TEST_ASSERT_EQUAL_STRING("VNERR,08", wire_command(&wire, "VNRRG,99"));
    TEST_ASSERT_EQUAL_STRING("VNRRG,06,0", wire_command(&wire, "VNRRG,06"));
}

/* The reply comes at the old speed; from its end on only the new one is understood. */
static void test_speed_changes_after_the_reply(void) {
    open_quiet(3);
    wire_say(&wire, "$VNWRG,05,230400*5A\r\n");
    TEST_ASSERT_EQUAL_UINT64(wire.now_us + 1000, world_imu_due_us(wire.world));
    wire_follow(&wire, wire.now_us + 1000);
    TEST_ASSERT_EQUAL(115200, world_imu_baud(wire.world));
    wire_run(&wire, wire.now_us + 20000);
    TEST_ASSERT_EQUAL_STRING("$VNWRG,05,230400*5A", wire.line);
    TEST_ASSERT_EQUAL(230400, world_imu_baud(wire.world));
    TEST_ASSERT_EQUAL_STRING("", wire_ask(&wire, "$VNRRG,05*XX"));
    wire.baud = 236000; /* 2.4 % off */
    TEST_ASSERT_EQUAL_STRING("$VNRRG,05,230400*5F", wire_ask(&wire, "$VNRRG,05*76"));
    wire.baud = 238000; /* 3.3 % */
    TEST_ASSERT_EQUAL_STRING("", wire_ask(&wire, "$VNRRG,05*76"));
    wire.baud = 230400;
    wire_set(&wire, "VNWRG,05,115200");
    wire.baud = 115200;
    TEST_ASSERT_EQUAL_STRING("VNRRG,05,115200", wire_command(&wire, "VNRRG,05"));
}

/* Also when the reply waits behind others; and while it is on the line the old speed is heard. */
static void test_speed_changes_late(void) {
    uint8_t bytes[WORLD_IMU_MESSAGE_MAX];
    open_quiet(3);
    wire_say(&wire, "$VNRRG,23*XX\r$VNWRG,05,230400*XX\r$VNRRG,07*XX\r");
    const uint64_t begin = wire.now_us;
    static const char *const starts[] = {"$VNRRG,23", "$VNWRG,05", "$VNRRG,07"};
    static const unsigned bauds[] = {115200, 115200, 230400};
    uint64_t free_us = begin;
    for (unsigned i = 0; i < 3; i++) {
        const uint64_t due = world_imu_due_us(wire.world);
        wire_follow(&wire, due);
        TEST_ASSERT_TRUE(due >= free_us);
        TEST_ASSERT_EQUAL(bauds[i], world_imu_baud(wire.world));
        const size_t length = world_imu_read(wire.world, bytes);
        TEST_ASSERT_EQUAL_STRING_LEN(starts[i], bytes, 9);
        free_us = due + length * 10 * 1000000 / bauds[i];
    }
    wire_run(&wire, begin + 100000);
    wire.baud = 230400;
    wire_say(&wire, "$VNWRG,05,115200*XX\r\n");
    wire_run(&wire, wire.now_us + 1200);
    TEST_ASSERT_EQUAL_STRING("VNRRG,07,40", wire_command(&wire, "VNRRG,07"));
    TEST_ASSERT_EQUAL_STRING("", wire_ask(&wire, "$VNRRG,07*74"));
}

static void test_frames_leave_by_the_port_that_register_75_names(void) {
    sim_config_t c = vn100_config(1);
    for (unsigned port = 1; port <= 2; port++) {
        c.imu_port = port;
        wire_open(&wire, &c);
        wire_run(&wire, 1000000);
        wire_set(&wire, "VNWRG,06,0");
        wire_set(&wire, port == 2 ? "VNWRG,75,1,8,11,0129,0040" : FISH_FRAME);
        wire_run(&wire, wire.now_us + 1000000);
        TEST_ASSERT_EQUAL(0, wire.frames); /* the wrong number is silence */
        wire_set(&wire, port == 1 ? "VNWRG,75,1,8,11,0129,0040" : FISH_FRAME);
        const unsigned before = wire.frames;
        wire_run(&wire, wire.now_us + 1000000);
        TEST_ASSERT_UINT_WITHIN(1, 100, wire.frames - before);
        /* ASCII settings without a port are of the one the command came by. */
        char named[40];
        snprintf(named, sizeof named, "VNRRG,06,%u", port);
        TEST_ASSERT_EQUAL_STRING_LEN("VNRRG,06,0", wire_command(&wire, named), 10);
        snprintf(named, sizeof named, "VNRRG,06,%u", 3 - port);
        TEST_ASSERT_EQUAL_STRING_LEN("VNRRG,06,14", wire_command(&wire, named), 11);
        if (port == 1) {
            wire_close(&wire);
        }
    }
}

static void test_half_commands_and_noise(void) {
    open_quiet(3);
    wire_say(&wire, "\r\n\r\n$VNRR");
    wire_run(&wire, wire.now_us + 10000);
    TEST_ASSERT_EQUAL_STRING("$VNRRG,07,40*5C", wire_ask(&wire, "$VNRRG,07*74"));
    wire_say(&wire, "$VNRRG\xA5,07*74\r\n");
    wire_say(&wire, "\xFA\x01$\xFF\r\n$VNRRG,07");
    TEST_ASSERT_EQUAL_STRING("$VNRRG,07,40*5C", wire_ask(&wire, "*74"));
    TEST_ASSERT_EQUAL(0, wire.errors);
    const unsigned lines = wire.lines;
    wire_say(&wire, "$VNRRG,07*74\r$VNRRG,07*74\n"); /* either end will do */
    wire_run(&wire, wire.now_us + 20000);
    TEST_ASSERT_EQUAL(lines + 2, wire.lines);
    char long_line[400];
    memset(long_line, 'x', sizeof long_line);
    long_line[0] = '$';
    long_line[399] = '\0';
    TEST_ASSERT_EQUAL_STRING("$VNERR,02*73", wire_ask(&wire, long_line));
    TEST_ASSERT_EQUAL_STRING("$VNRRG,07,40*5C", wire_ask(&wire, "$VNRRG,07*74"));
}

/* 19 questions at once, whose answers are longer than its output buffer. */
static void test_output_buffer_overflows(void) {
    char questions[260] = "";
    open_quiet(3);
    for (unsigned i = 0; i < 19; i++) {
        strcat(questions, "$VNRRG,23*XX\r");
    }
    wire_say(&wire, questions);
    const unsigned lines = wire.lines;
    wire_run(&wire, wire.now_us + 300000);
    TEST_ASSERT_TRUE(wire.lines - lines > 14 && wire.lines - lines <= 19);
    TEST_ASSERT_TRUE(wire.errors > 0);
    TEST_ASSERT_EQUAL_STRING("$VNRRG,07,40*5C", wire_ask(&wire, "$VNRRG,07*74"));
}

/* Power-on: 0.2 s after its supply, $VNYMR at 40 Hz and nothing else. */
static void test_factory_settings(void) {
    const sim_config_t c = vn100_config(1);
    wire_open(&wire, &c);
    TEST_ASSERT_EQUAL_UINT64(261000 - 2, world_imu_due_us(wire.world));
    wire_run(&wire, 250000);
    wire_say(&wire, "$VNWRG,06,0*6C\r\n"); /* too early */
    wire_run(&wire, 261000 + 1000000 - 1000);
    TEST_ASSERT_EQUAL(40, wire.lines);
    TEST_ASSERT_EQUAL(40, wire.messages);
    TEST_ASSERT_EQUAL(40 * 122, wire.bytes);
    TEST_ASSERT_EQUAL_STRING_LEN("$VNYMR,", wire.line, 7);
    TEST_ASSERT_EQUAL(115200, world_imu_baud(wire.world));
}

static void test_low_saved_speed_goes_with_few_messages(void) {
    sim_config_t c = vn100_config(1);
    c.imu_baud = 9600;
    wire_open(&wire, &c);
    wire.baud = 9600;
    wire_run(&wire, 2000000);
    TEST_ASSERT_EQUAL(9600, world_imu_baud(wire.world));
    TEST_ASSERT_UINT_WITHIN(1, 9, wire.lines);
    wire_set(&wire, "VNWRG,06,0");
    wire_set(&wire, "VNWRG,05,115200");
}

/* Same characters in the same places as in lines of real sensors. */
static void check_shape(const char *type, const char *real) {
    char body[40];
    snprintf(body, sizeof body, "VNWRG,06,%s", type);
    wire_set(&wire, body);
    wire_run(&wire, wire.now_us + 100000);
    TEST_ASSERT_EQUAL_STRING_LEN(real, wire.line, 7);
    TEST_ASSERT_EQUAL(strlen(real), strlen(wire.line));
    for (size_t i = 0; real[i] != '*'; i++) {
        const bool sign = real[i] == '+' || real[i] == '-';
        const bool digit = real[i] >= '0' && real[i] <= '9';
        const char got = wire.line[i];
        TEST_ASSERT_TRUE(sign    ? got == '+' || got == '-'
                         : digit ? got >= '0' && got <= '9'
                                 : got == real[i]);
    }
}

static void test_lines_look_like_real_ones(void) {
    open_quiet(3);
    check_shape("1", "$VNYPR,+010.071,+000.278,-002.026*60");
    check_shape("14", "$VNYMR,+100.949,-007.330,+000.715,-00.0049,-00.2449,+00.5397,-01.258,"
                      "-00.100,-09.701,-00.000018,+00.001122,-00.000551*69");
    check_shape("16", "$VNYBA,+059.745,+003.857,-004.949,+00.001,-00.008,+00.150,+00.000478,"
                      "-00.000896,-00.001366*5B");
    check_shape("17", "$VNYIA,+059.745,+003.857,-004.949,+00.001,-00.008,+00.150,+00.000478,"
                      "-00.000896,-00.001366*5B");
    check_shape("19", "$VNIMU,-00.0350,+00.4222,-00.6643,-00.015,+00.019,+09.948,+00.002066,"
                      "-00.008442,-00.044656,+20.7,+084.322*66");
    wire_set(&wire, "VNWRG,30,2,0,0,0,1,0,1");
    check_shape("8", "$VNQMR,+0.004183,+0.001149,+0.089285,+0.995997,+00.0113,-00.2384,+00.1800,"
                     "+00.020,-00.092,-09.683,-00.000272,+00.000824,+00.000073,T0000000543*3D");
    wire_close(&wire);
    open_quiet(2);
    wire_set(&wire, "VNWRG,30,2,1,0,0,1,0,1");
    check_shape("1", "$VNYPR,+010.071,+000.278,-002.026,T1162704,S0000*50");
}

/* Any layout has the length that its fields have, and a right CRC. */
static void test_every_field_has_its_size(void) {
    static const struct {
        unsigned group, bytes[16];
    } groups[] = {
        {0, {8, 8, 8, 12, 16, 12, 24, 12, 12, 24, 20, 28, 2, 4, 8}},
        {1, {8, 8, 8, 2, 8, 8, 8, 4, 4, 1}},
        {2, {2, 12, 12, 12, 4, 4, 16, 12, 12, 12, 12, 2}},
        {4, {2, 12, 16, 36, 12, 12, 12, 12, 12, 0, 0, 0, 12, 4}},
    };
    open_quiet(3);
    for (unsigned g = 0; g < 4; g++) {
        unsigned all = 0, sum = 0;
        for (unsigned bit = 0; bit <= 16; bit++) {
            if (bit < 16 && groups[g].bytes[bit] == 0) {
                continue;
            }
            char body[60];
            snprintf(body, sizeof body, "VNWRG,77,2,100,%02X,%04X", 1u << groups[g].group,
                     bit < 16 ? 1u << bit : all);
            wire_set(&wire, body);
            all |= bit < 16 ? 1u << bit : 0;
            sum += bit < 16 ? groups[g].bytes[bit] : 0;
            wire_run(&wire, wire.now_us + 125000 + 125000);
            const unsigned before = wire.frames;
            const size_t bytes = wire.bytes;
            wire_run(&wire, wire.now_us + 125000);
            TEST_ASSERT_EQUAL(before + 1, wire.frames);
            TEST_ASSERT_EQUAL(6 + (bit < 16 ? groups[g].bytes[bit] : sum), wire.bytes - bytes);
        }
    }
    TEST_ASSERT_EQUAL(0, wire.bad);
}

static void test_saved_settings_survive_unsaved_ones_do_not(void) {
    open_quiet(3);
    wire_set(&wire, FISH_FRAME);
    wire_set(&wire, "VNASY,0");
    const uint64_t began = wire.now_us;
    wire_say(&wire, "$VNWNV*57\r\n");
    wire_run(&wire, began + 200000);
    const unsigned lines = wire.lines;
    wire_say(&wire, "$VNRRG,07*74\r\n"); /* waits for the flash */
    wire_run(&wire, began + 499000);
    TEST_ASSERT_EQUAL(lines, wire.lines);
    wire_run(&wire, began + 520000);
    TEST_ASSERT_EQUAL(lines + 2, wire.lines);
    TEST_ASSERT_EQUAL_STRING("$VNRRG,07,40*5C", wire.line);
    wire_set(&wire, "VNWRG,07,20");
    TEST_ASSERT_EQUAL_STRING("$VNRST*4D", wire_ask(&wire, "$VNRST*4D"));
    wire_run(&wire, wire.now_us + 1000000);
    TEST_ASSERT_EQUAL_STRING("VNRRG,07,40", wire_command(&wire, "VNRRG,07"));
    TEST_ASSERT_EQUAL_STRING(FISH_FRAME + 9,
                             wire_command(&wire, "VNRRG,75") + 9); /* and not paused any more */
    TEST_ASSERT_TRUE(wire.frames > 70 && wire.last.time_ns < 1100000000u);
    world_imu_power_off(wire.world);
    wire_run(&wire, wire.now_us + 100000);
    world_imu_power_on(wire.world, wire.now_us);
    wire.frames = 0;
    wire_run(&wire, wire.now_us + 1261500);
    TEST_ASSERT_EQUAL(101, wire.frames);
    wire_say(&wire, "$VNRFS*5F\r\n");
    wire_run(&wire, wire.now_us + 1500000);
    TEST_ASSERT_EQUAL_STRING_LEN("$VNYMR,", wire.line, 7);
    TEST_ASSERT_EQUAL_STRING("VNRRG,75,0,0,00", wire_command(&wire, "VNASY,0") == NULL
                                                    ? ""
                                                    : wire_command(&wire, "VNRRG,75"));
}

/* Mounting: only after it was saved and the sensor has restarted. */
static void test_mounting_takes_effect_after_a_restart(void) {
    const sim_config_t c = vn100_config(0);
    wire_open(&wire, &c);
    wire_stream(&wire);
    TEST_ASSERT_EQUAL_STRING_LEN("VNWRG,26,", wire_command(&wire, "VNWRG,26,1,0,0,0,-1,0,0,0,-1"),
                                 9);
    wire_run(&wire, wire.now_us + 100000);
    TEST_ASSERT_FLOAT_WITHIN(1e-5, -G_M_S2, wire.last.accel_m_s2[2]);
    wire_say(&wire, "$VNWNV*57\r\n");
    wire_run(&wire, wire.now_us + 600000);
    wire_say(&wire, "$VNRST*4D\r\n");
    wire_run(&wire, wire.now_us + 600000);
    TEST_ASSERT_FLOAT_WITHIN(1e-5, G_M_S2, wire.last.accel_m_s2[2]);
    TEST_ASSERT_FLOAT_WITHIN(1e-3, 180, fabs(wire.last.ypr_deg[2]));
}

static void test_restart_by_itself(void) {
    const sim_config_t c = vn100_config(1);
    wire_open(&wire, &c);
    wire_stream(&wire);
    wire_run(&wire, 3000000);
    TEST_ASSERT_TRUE(wire.last.time_ns > 2900000000u);
    const unsigned frames = wire.frames, lines = wire.lines;
    world_imu_reboot(wire.world, wire.now_us);
    wire_run(&wire, wire.now_us + 199000);
    TEST_ASSERT_EQUAL(lines, wire.lines);
    wire_run(&wire, wire.now_us + 801000);
    TEST_ASSERT_EQUAL(frames, wire.frames); /* the settings were not saved */
    TEST_ASSERT_UINT_WITHIN(1, lines + 32, wire.lines);
    TEST_ASSERT_EQUAL_STRING_LEN("$VNYMR,", wire.line, 7);
}

static void test_wedged_until_the_power_is_off(void) {
    const sim_config_t c = vn100_config(1);
    wire_open(&wire, &c);
    wire_run(&wire, 1000000);
    world_imu_wedge(wire.world);
    TEST_ASSERT_TRUE(world_imu_due_us(wire.world) == UINT64_MAX);
    TEST_ASSERT_EQUAL_STRING("", wire_ask(&wire, "$VNRST*4D"));
    world_imu_reboot(wire.world, wire.now_us);
    wire_run(&wire, 2000000);
    TEST_ASSERT_EQUAL_STRING("", wire_ask(&wire, "$VNRRG,01*72"));
    world_imu_power_off(wire.world);
    world_imu_power_on(wire.world, wire.now_us);
    const unsigned lines = wire.lines;
    wire_run(&wire, wire.now_us + 1000000);
    TEST_ASSERT_TRUE(wire.lines > lines + 25);
}

/* 0.1 % of the bits: 1 - 0.999^512 = 40.1 % of the frames; 0.1 % of the bytes: 6.2 %. */
static void test_damage_on_the_wires(void) {
    sim_config_t c = vn100_config(1);
    c.imu_bit_errors = 0.001;
    wire_open(&wire, &c);
    wire_run(&wire, 500000);
    unsigned answered = 0;
    for (unsigned i = 0; i < 100; i++) {
        const unsigned lines = wire.lines;
        wire_ask(&wire, "$VNWRG,06,0*6C");
        answered += wire.lines != lines && strcmp(wire.line, "$VNWRG,06,0*6C") == 0;
    }
    /* two ways of 16 characters, CR and LF */
    TEST_ASSERT_UINT_WITHIN(16, 76, answered);
    while (strcmp(wire_ask(&wire, "$VNWRG,75,2,8,11,0129,0040*5C"),
                  "$VNWRG,75,2,8,11,0129,0040*5C") != 0) {
    }
    wire.messages = wire.bad = wire.frames = 0;
    wire_run(&wire, wire.now_us + 30000000);
    TEST_ASSERT_UINT_WITHIN(1, 3000, wire.messages);
    TEST_ASSERT_UINT_WITHIN(120, 1203, wire.messages - wire.frames);
    wire_close(&wire);
    c.imu_bit_errors = 0;
    c.imu_lost_bytes = 0.001;
    wire_open(&wire, &c);
    wire_run(&wire, 500000);
    while (strcmp(wire_ask(&wire, "$VNWRG,75,2,8,11,0129,0040*5C"),
                  "$VNWRG,75,2,8,11,0129,0040*5C") != 0) {
    }
    wire.messages = wire.frames = wire.lines = wire.bad = 0;
    wire_run(&wire, wire.now_us + 30000000);
    TEST_ASSERT_UINT_WITHIN(60, 3000 * 62 / 1000, 3000 - wire.frames);
}

static uint32_t digest_of(double seed, double noise) {
    sim_config_t c = vn100_config(noise);
    c.seed = (uint64_t)seed;
    wire_open(&wire, &c);
    wire_stream(&wire);
    wire.amplitude_rad = 0.6;
    wire_run(&wire, 4000000);
    const uint32_t digest = wire.digest;
    wire_close(&wire);
    return digest;
}

static void test_seed_decides(void) {
    const uint32_t first = digest_of(1, 1);
    TEST_ASSERT_EQUAL_HEX32(first, digest_of(1, 1));
    TEST_ASSERT_TRUE(first != digest_of(2, 1));
    TEST_ASSERT_TRUE(first != digest_of(1, 2));
}

static void test_no_sensor(void) {
    sim_config_t c = vn100_config(1);
    c.imu_firmware = 0;
    wire_open(&wire, &c);
    TEST_ASSERT_TRUE(world_imu_due_us(wire.world) == UINT64_MAX);
    TEST_ASSERT_EQUAL_STRING("", wire_ask(&wire, "$VNRRG,01*72"));
    world_set_imu(wire.world, wire.now_us, false);
    world_set_imu(wire.world, wire.now_us, true);
    TEST_ASSERT_TRUE(world_imu_due_us(wire.world) == UINT64_MAX);
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_commands_of_the_manual);
    RUN_TEST(test_sixteen_bit_checks);
    RUN_TEST(test_errors_say_what_is_wrong);
    RUN_TEST(test_error_numbers_in_both_notations);
    RUN_TEST(test_what_does_not_fit_the_line_is_refused);
    RUN_TEST(test_outputs_of_a_port_share_its_line);
    RUN_TEST(test_an_error_mode_keeps_quiet);
    RUN_TEST(test_speed_changes_after_the_reply);
    RUN_TEST(test_speed_changes_late);
    RUN_TEST(test_frames_leave_by_the_port_that_register_75_names);
    RUN_TEST(test_half_commands_and_noise);
    RUN_TEST(test_output_buffer_overflows);
    RUN_TEST(test_factory_settings);
    RUN_TEST(test_low_saved_speed_goes_with_few_messages);
    RUN_TEST(test_lines_look_like_real_ones);
    RUN_TEST(test_every_field_has_its_size);
    RUN_TEST(test_saved_settings_survive_unsaved_ones_do_not);
    RUN_TEST(test_mounting_takes_effect_after_a_restart);
    RUN_TEST(test_restart_by_itself);
    RUN_TEST(test_wedged_until_the_power_is_off);
    RUN_TEST(test_damage_on_the_wires);
    RUN_TEST(test_seed_decides);
    RUN_TEST(test_no_sensor);
    return UNITY_END();
}
