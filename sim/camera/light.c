#include "light.h"

#include "base/panic.h"

static uint64_t edge_us(const light_t *light, uint64_t number) {
    return light->edge_us[number % LIGHT_EDGES];
}

static bool is_on(uint64_t edges) { return edges % 2 != 0; }

void light_set(light_t *light, uint64_t now_us, bool on) {
    if (on == is_on(light->edges)) {
        return;
    }
    REQUIRE(light->edges == 0 || now_us >= edge_us(light, light->edges - 1));
    light->edge_us[light->edges++ % LIGHT_EDGES] = now_us;
}

double light_part(const light_t *light, uint64_t from_us, uint64_t to_us) {
    const uint64_t forgotten = light->edges > LIGHT_EDGES ? light->edges - LIGHT_EDGES : 0;
    uint64_t edges = light->edges; /* up to the time looked at */
    while (edges > forgotten && edge_us(light, edges - 1) > to_us) {
        edges--;
    }
    if (from_us == to_us) {
        return is_on(edges) ? 1 : 0;
    }
    uint64_t on_us = 0;
    uint64_t until_us = to_us;
    while (edges > forgotten && edge_us(light, edges - 1) > from_us) {
        const uint64_t since_us = edge_us(light, edges - 1);
        on_us += is_on(edges) ? until_us - since_us : 0;
        until_us = since_us;
        edges--;
    }
    on_us += is_on(edges) ? until_us - from_us : 0;
    return (double)on_us / (double)(to_us - from_us);
}
