// main.cpp: node @node@ as a program. Build: @build@
// Start: ./participant CHANNEL ... (a channel for each bus of table.c).
#include "participant.hpp"

#include <cstdio>
#include <exception>

extern "C" {
#include "linux.h"
#include "table.h"
}

// The law, once a slot. Received values are those accepted last.
static void law(const cosim::Slot &slot)
{
    (void)slot;
    /* @law@ */
}

int main(int argc, char **argv)
try {
    return cosim::run(run_on_can, argc, argv, TABLE, law);
} catch (const std::exception &error) {
    std::fprintf(stderr, "error: %s\n", error.what());
    return 1;
}
