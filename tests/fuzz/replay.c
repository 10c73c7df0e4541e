/*
 * A main() for the targets without libFuzzer: runs each input of a corpus, then mutations of them
 * from a fixed seed. What it does depends on its arguments only.
 *
 * Usage: TARGET MUTATIONS FILE...   (*.pack: many inputs, each after its length; others: one input)
 */
#include "fuzz.h"

#define INPUTS_MAX 2048u
#define INPUT_MAX_BYTES 4096u
#define EDITS_MAX 8u

typedef struct {
    uint8_t *bytes;
    size_t length;
} seed_t;

static seed_t seeds[INPUTS_MAX];
static size_t seed_count;
static uint32_t random_state = 20u;

static uint32_t draw(uint32_t below) {
    random_state ^= random_state << 13;
    random_state ^= random_state >> 17;
    random_state ^= random_state << 5;
    return random_state % below;
}

/* In a block of its own, so that a read beyond its end is seen. */
static void run(const uint8_t *bytes, size_t length) {
    uint8_t *copy = malloc(length != 0 ? length : 1);
    MUST(copy != NULL);
    memcpy(copy, bytes, length);
    (void)LLVMFuzzerTestOneInput(copy, length);
    free(copy);
}

static void add_seed(const uint8_t *bytes, size_t length) {
    MUST(seed_count < INPUTS_MAX);
    seed_t *seed = &seeds[seed_count++];
    seed->bytes = malloc(length != 0 ? length : 1);
    MUST(seed->bytes != NULL);
    memcpy(seed->bytes, bytes, length);
    seed->length = length;
}

static void add_pack(const uint8_t *bytes, size_t length) {
    input_t in = {bytes, length};
    while (in.left != 0) {
        size_t got = 0;
        const size_t wanted = take_u16(&in);
        const uint8_t *at = take_bytes(&in, wanted, &got);
        MUST(got == wanted);
        add_seed(at, got);
    }
}

static void add_file(const char *path) {
    FILE *file = fopen(path, "rb");
    if (file == NULL) {
        perror(path);
        exit(2);
    }
    static uint8_t bytes[1u << 20];
    const size_t length = fread(bytes, 1, sizeof bytes, file);
    MUST(length < sizeof bytes);
    (void)fclose(file);
    const char *dot = strrchr(path, '.');
    if (dot != NULL && strcmp(dot, ".pack") == 0) {
        add_pack(bytes, length);
    } else {
        add_seed(bytes, length);
    }
}

static size_t insert(uint8_t *bytes, size_t length, size_t at, const uint8_t *what, size_t size) {
    if (length + size > INPUT_MAX_BYTES) {
        return length;
    }
    uint8_t piece[256];
    memcpy(piece, what, size); /* it may be a part of |bytes| */
    memmove(bytes + at + size, bytes + at, length - at);
    memcpy(bytes + at, piece, size);
    return length + size;
}

static size_t edit(uint8_t *bytes, size_t length) {
    static const uint8_t edges[] = {0, 1, 0x7F, 0x80, 0xFE, 0xFF};
    const size_t at = length == 0 ? 0 : draw((uint32_t)length);
    const size_t rest = length - at;
    const size_t size = rest == 0 ? 0 : 1 + draw((uint32_t)(rest < 64 ? rest : 64));
    const seed_t *other = &seeds[draw((uint32_t)seed_count)];
    const uint8_t noise = (uint8_t)draw(256);
    switch (length == 0 ? 3u : draw(7)) {
    case 0:
        bytes[at] ^= (uint8_t)(1u << draw(8));
        return length;
    case 1:
        bytes[at] = edges[draw(sizeof edges)];
        return length;
    case 2:
        bytes[at] = noise;
        return length;
    case 3:
        return insert(bytes, length, at, &noise, 1);
    case 4:
        memmove(bytes + at, bytes + at + size, rest - size);
        return length - size;
    case 5:
        return insert(bytes, length, draw((uint32_t)length), bytes + at, size);
    default:
        if (other->length == 0) {
            return length;
        }
        const size_t from = draw((uint32_t)other->length);
        const size_t there = other->length - from;
        return insert(bytes, length, at, other->bytes + from, there < 200 ? there : 200);
    }
}

static void mutate(const seed_t *seed) {
    uint8_t bytes[INPUT_MAX_BYTES];
    size_t length = seed->length < sizeof bytes ? seed->length : sizeof bytes;
    memcpy(bytes, seed->bytes, length);
    for (uint32_t edits = 1 + draw(EDITS_MAX); edits > 0; edits--) {
        length = edit(bytes, length);
    }
    run(bytes, length);
}

int main(int count, char **arguments) {
    if (count < 3) {
        fprintf(stderr, "usage: %s MUTATIONS FILE...\n", arguments[0]);
        return 2;
    }
    for (int i = 2; i < count; i++) {
        add_file(arguments[i]);
    }
    for (size_t i = 0; i < seed_count; i++) {
        run(seeds[i].bytes, seeds[i].length);
    }
    const unsigned long mutations = strtoul(arguments[1], NULL, 10);
    for (unsigned long i = 0; i < mutations && seed_count != 0; i++) {
        mutate(&seeds[draw((uint32_t)seed_count)]);
    }
    printf("%lu inputs, %lu mutations of them\n", (unsigned long)seed_count, mutations);
    for (size_t i = 0; i < seed_count; i++) {
        free(seeds[i].bytes);
    }
    return 0;
}
