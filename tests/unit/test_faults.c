#include "supervisor/faults.h"

#include "mock_hal.h"
#include "unity.h"

#include <string.h>

void setUp(void) {}
void tearDown(void) {}

static void numbers_rise_and_names_differ(void) {
    for (uint16_t row = 1; row < fault_count(); row++) {
        TEST_ASSERT_TRUE(fault_row(row)->number > fault_row((uint16_t)(row - 1))->number);
        for (uint16_t other = 0; other < row; other++) {
            TEST_ASSERT_NOT_EQUAL(0, strcmp(fault_row(row)->name, fault_row(other)->name));
        }
    }
}

static void every_row_says_what_and_what_to_do(void) {
    for (uint16_t row = 0; row < fault_count(); row++) {
        const fault_info_t *info = fault_row(row);
        TEST_ASSERT_TRUE(strlen(info->name) > 0);
        TEST_ASSERT_TRUE_MESSAGE(strlen(info->meaning) > 0 && strlen(info->meaning) <= 49,
                                 info->name);
        TEST_ASSERT_TRUE_MESSAGE((strlen(fault_remedy(row)) > 0) == (info->number != 0),
                                 info->name);
        TEST_ASSERT_TRUE((info->kind == FAULT_KIND_NONE) == (info->number == 0));
    }
}

/* Files and hosts know these for ever. A new fault gets a new row here; none ever changes. */
static const struct {
    uint16_t number;
    const char *name;
    fault_kind_t kind;
} KNOWN[] = {
    {0, "NONE", FAULT_KIND_NONE},
    {1, "ABORT_COMMAND", FAULT_KIND_ABORT},
    {2, "LINK_LOST", FAULT_KIND_ABORT},
    {3, "IMU_STALE", FAULT_KIND_ABORT},
    {4, "TILT", FAULT_KIND_ABORT},
    {5, "REBOOT", FAULT_KIND_ABORT},
    {6, "WALL", FAULT_KIND_ABORT},
    {7, "ERROR_LIMIT", FAULT_KIND_ABORT},
    {20, "BATTERY_CRITICAL", FAULT_KIND_FAULT},
    {21, "LATE_TICK", FAULT_KIND_FAULT},
    {22, "STORAGE", FAULT_KIND_FAULT},
    {23, "SERVO_CONFIG", FAULT_KIND_FAULT},
    {24, "WATCHDOG", FAULT_KIND_FAULT},
    {25, "CRASH", FAULT_KIND_FAULT},
    {26, "CLOCK", FAULT_KIND_FAULT},
    {27, "STORE_RENEWED", FAULT_KIND_FAULT},
    {28, "KEY_UNREADABLE", FAULT_KIND_FAULT},
    {29, "FILE_DAMAGED", FAULT_KIND_FAULT},
    {30, "STORE_OLDER", FAULT_KIND_FAULT},
    {31, "BATTERY_SENSE", FAULT_KIND_FAULT},
    {32, "MONITOR", FAULT_KIND_FAULT},
    {33, "STORE_UNFIT", FAULT_KIND_FAULT},
    {40, "WRONG_STATE", FAULT_KIND_REFUSAL},
    {41, "NO_REFERENCE", FAULT_KIND_REFUSAL},
    {42, "BATTERY_LOW", FAULT_KIND_REFUSAL},
    {43, "TRIAL_NUMBER", FAULT_KIND_REFUSAL},
    {44, "STALE_COMMAND", FAULT_KIND_REFUSAL},
    {45, "TRIAL_PENDING", FAULT_KIND_REFUSAL},
    {46, "NO_TRIAL", FAULT_KIND_REFUSAL},
    {47, "NOTHING_MEASURED", FAULT_KIND_REFUSAL},
    {48, "BAD_LAW", FAULT_KIND_REFUSAL},
    {49, "BAD_DATA", FAULT_KIND_REFUSAL},
    {50, "BAD_FILE", FAULT_KIND_REFUSAL},
    {51, "BAD_FORMAT", FAULT_KIND_REFUSAL},
    {52, "TOO_FAST", FAULT_KIND_REFUSAL},
    {53, "TOO_FAR", FAULT_KIND_REFUSAL},
    {54, "BAD_PARAM", FAULT_KIND_REFUSAL},
    {55, "NO_BEST", FAULT_KIND_REFUSAL},
    {56, "WRITE_FAILED", FAULT_KIND_REFUSAL},
    {57, "UNKNOWN_COMMAND", FAULT_KIND_REFUSAL},
    {58, "WRONG_BEATS", FAULT_KIND_REFUSAL},
    {59, "NO_IMU", FAULT_KIND_REFUSAL},
    {60, "NOT_STILL", FAULT_KIND_REFUSAL},
    {61, "RESTS_DIFFER", FAULT_KIND_REFUSAL},
    {62, "NOT_SIGNED", FAULT_KIND_REFUSAL},
    {63, "NOT_FRESH", FAULT_KIND_REFUSAL},
    {64, "NOT_WIRED", FAULT_KIND_REFUSAL},
    {65, "OTHER_HOST", FAULT_KIND_REFUSAL},
    {66, "LAW_FEEDBACK", FAULT_KIND_REFUSAL},
    {67, "LAW_SIGN", FAULT_KIND_REFUSAL},
    {68, "SERVO_UNSAVED", FAULT_KIND_REFUSAL},
    {69, "ERASING", FAULT_KIND_REFUSAL},
};

static void numbers_are_stable(void) {
    const size_t known = sizeof KNOWN / sizeof KNOWN[0];
    for (size_t i = 0; i < known; i++) {
        const fault_info_t *info = fault_info((fault_t)KNOWN[i].number);
        TEST_ASSERT_EQUAL_UINT16_MESSAGE(KNOWN[i].number, info->number, KNOWN[i].name);
        TEST_ASSERT_EQUAL_STRING(KNOWN[i].name, info->name);
        TEST_ASSERT_EQUAL_INT_MESSAGE(KNOWN[i].kind, info->kind, KNOWN[i].name);
    }
    TEST_ASSERT_EQUAL_MESSAGE(known, fault_count(), "a fault is missing in this list");
}

/* A kind has a range of numbers, so that a host tells a fault it does not know. */
static void kinds_have_their_ranges(void) {
    for (uint16_t row = 1; row < fault_count(); row++) {
        const fault_info_t *info = fault_row(row);
        const fault_kind_t kind = info->number < 20   ? FAULT_KIND_ABORT
                                  : info->number < 40 ? FAULT_KIND_FAULT
                                                      : FAULT_KIND_REFUSAL;
        TEST_ASSERT_EQUAL_INT_MESSAGE(kind, info->kind, info->name);
    }
}

static void every_number_finds_its_row_and_others_none(void) {
    uint16_t row = 0;
    /* On the board a fault_t is a byte. */
    for (uint16_t number = 0; number <= UINT8_MAX; number++) {
        const fault_info_t *info = fault_info((fault_t)number);
        if (row < fault_count() && fault_row(row)->number == number) {
            TEST_ASSERT_EQUAL_PTR(fault_row(row), info);
            row++;
        } else {
            TEST_ASSERT_EQUAL_PTR(fault_row(0), info);
        }
    }
    TEST_ASSERT_EQUAL_UINT16(fault_count(), row);
}

static void a_row_beyond_the_table_is_our_mistake(void) {
    volatile bool panicked;
    MOCK_EXPECT_PANIC(panicked, (void)fault_row(fault_count()));
    TEST_ASSERT_TRUE(panicked);
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(numbers_rise_and_names_differ);
    RUN_TEST(every_row_says_what_and_what_to_do);
    RUN_TEST(numbers_are_stable);
    RUN_TEST(kinds_have_their_ranges);
    RUN_TEST(every_number_finds_its_row_and_others_none);
    RUN_TEST(a_row_beyond_the_table_is_our_mistake);
    return UNITY_END();
}
