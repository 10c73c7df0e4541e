#include "report.h"

void report_range(suite_t *suite, const char *name, uint64_t value, const char *unit,
                  uint64_t least, uint64_t most, const char *why) {
    text_t text = {.length = 0};
    const bool ok = value >= least && value <= most;
    text_word(&text, "check");
    text_word(&text, name);
    text_number(&text, value);
    text_word(&text, unit);
    text_number(&text, least);
    text_number(&text, most);
    text_word(&text, ok ? "ok" : "failed");
    if (!ok) {
        text_word(&text, why);
    }
    console_say(&suite->console, &text);
}

void report_cases(suite_t *suite, const char *name, uint32_t right, uint32_t all, const char *why) {
    report_range(suite, name, right, "cases", all, all, why);
}

void report_absent(suite_t *suite, const char *name, const char *why) {
    text_t text = {.length = 0};
    text_word(&text, "check");
    text_word(&text, name);
    text_word(&text, "- - - - absent");
    text_word(&text, why);
    console_say(&suite->console, &text);
}

void report_request(suite_t *suite, const char *keyword, uint64_t number) {
    text_t text = {.length = 0};
    text_word(&text, keyword);
    text_number(&text, number);
    console_say(&suite->console, &text);
}
