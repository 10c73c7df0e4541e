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

/* Files and hosts know these for ever. */
static void numbers_are_stable(void) {
    const struct {
        uint16_t number;
        const char *name;
        fault_kind_t kind;
    } known[] = {
        {0, "NONE", FAULT_KIND_NONE},
        {1, "ABORT_COMMAND", FAULT_KIND_ABORT},
        {2, "LINK_LOST", FAULT_KIND_ABORT},
        {3, "IMU_STALE", FAULT_KIND_ABORT},
        {4, "TILT", FAULT_KIND_ABORT},
        {5, "REBOOT", FAULT_KIND_ABORT},
        {20, "BATTERY_CRITICAL", FAULT_KIND_FAULT},
        {21, "LATE_TICK", FAULT_KIND_FAULT},
        {22, "STORAGE", FAULT_KIND_FAULT},
        {23, "SERVO_CONFIG", FAULT_KIND_FAULT},
        {24, "WATCHDOG", FAULT_KIND_FAULT},
        {40, "WRONG_STATE", FAULT_KIND_REFUSAL},
        {47, "NOTHING_MEASURED", FAULT_KIND_REFUSAL},
        {58, "WRONG_BEATS", FAULT_KIND_REFUSAL},
    };
    for (size_t i = 0; i < sizeof known / sizeof known[0]; i++) {
        const fault_info_t *info = fault_info((fault_t)known[i].number);
        TEST_ASSERT_EQUAL_UINT16(known[i].number, info->number);
        TEST_ASSERT_EQUAL_STRING(known[i].name, info->name);
        TEST_ASSERT_EQUAL_INT(known[i].kind, info->kind);
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
    RUN_TEST(every_number_finds_its_row_and_others_none);
    RUN_TEST(a_row_beyond_the_table_is_our_mistake);
    return UNITY_END();
}
