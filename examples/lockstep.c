/* A controller in lockstep with the emulated car, over its embedded CAN server: docs/lockstep.md.
 *
 *   cc -O2 -o controller examples/lockstep.c
 *   hev-can-emu run --clock lockstep --duration 5 &
 *   ./controller 29536
 *
 * Closes the contactors and holds EM2 at 30 km/h.  The network is dbc/hev.dbc. */
#include <arpa/inet.h>
#include <signal.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

enum { PERIOD_NS = 10000000, HV_REQUEST = 0x100, EM2_REQUEST = 0xC0, ESC_VEHICLE = 0x190 };

static int bus;

static void say(const char *text) {
    for (size_t left = strlen(text); left;) {
        ssize_t sent = write(bus, text, left);
        if (sent <= 0) return; /* the run is over: hear() will tell */
        text += sent, left -= sent;
    }
}

/* Read one element, "< ... >"; 0 at the end of the connection. */
static int hear(char *element, size_t size) {
    static char buffer[4096];
    static ssize_t at, end;
    for (size_t n = 0;;) {
        if (at == end) {
            at = 0, end = read(bus, buffer, sizeof buffer);
            if (end <= 0) return 0;
        }
        char c = buffer[at++];
        if (n + 1 < size) element[n++] = c;
        if (c == '>') return element[n] = 0, 1;
    }
}

/* Send a message of 8 bytes, protected by E2E profile 11: CRC 0x1D in byte 0, counter in byte 1. */
static void send_protected(unsigned id, unsigned data_id, uint64_t signals, unsigned counter) {
    uint8_t data[8], crc = 0;
    signals |= (uint64_t)(counter % 15) << 8;
    for (int i = 0; i < 8; i++) data[i] = signals >> 8 * i;
    for (int i = -1; i < 8; i++) { /* the data ID's two bytes, then bytes 1 to 7 */
        crc ^= i == -1 ? data_id & 0xFF : i == 0 ? data_id >> 8 : data[i];
        for (int bit = 0; bit < 8; bit++) crc = crc & 0x80 ? crc << 1 ^ 0x1D : crc << 1;
    }
    data[0] = crc;
    char text[64];
    int n = snprintf(text, sizeof text, "< send %03X 8", id);
    for (int i = 0; i < 8; i++) n += snprintf(text + n, sizeof text - n, " %02X", data[i]);
    snprintf(text + n, sizeof text - n, " >");
    say(text);
}

static void control(double speed_kmh, unsigned step) {
    double torque = 20.0 * (30.0 - speed_kmh); /* Nm */
    torque = torque > 120.0 ? 120.0 : torque < -120.0 ? -120.0 : torque;
    /* EM2ControlMode Torque, EM2TorqueRequest in 0.1 Nm from -800 Nm, 0 rpm, no bounds */
    uint64_t em2 = 1ull << 12 | (uint64_t)((torque + 800.0) * 10.0 + 0.5) << 16 | 16000ull << 30
                   | 511ull << 46 | 511ull << 55;
    send_protected(EM2_REQUEST, 8384, em2, step);
    if (step % 2 == 0) send_protected(HV_REQUEST, 8448, 1ull << 12, step / 2); /* Closed */
}

int main(int argc, char **argv) {
    struct sockaddr_in server = {.sin_family = AF_INET, .sin_port = htons(argc > 1 ? atoi(argv[1]) : 29536)};
    server.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    bus = socket(AF_INET, SOCK_STREAM, 0);
    if (connect(bus, (struct sockaddr *)&server, sizeof server)) return perror("connect"), 1;
    signal(SIGPIPE, SIG_IGN);
    char element[600], bytes[17];
    long long now;
    unsigned id, step = 0;
    double speed = 0.0;
    const char *handshake[] = {"< open vcan0 >", "< rawmode >", "< lockstep hcu >"};
    for (int i = 0; i < 3; i++) {
        if (!hear(element, sizeof element)) return 1;
        say(handshake[i]);
    }
    while (hear(element, sizeof element)) {
        if (sscanf(element, " < now %lld", &now) == 1) {
            control(speed, step++);
            snprintf(element, sizeof element, "< done %lld >", now + PERIOD_NS);
            say(element);
        } else if (sscanf(element, " < frame %x %*s %16s", &id, bytes) == 2 && id == ESC_VEHICLE) {
            char raw[5] = {bytes[6], bytes[7], bytes[4], bytes[5], 0}; /* VehicleSpeed */
            speed = strtol(raw, NULL, 16) * 0.01 - 100.0;
        } else if (strstr(element, "error")) {
            return fprintf(stderr, "%s\n", element), 1;
        }
    }
    printf("%u steps, %.2f km/h at the end\n", step, speed);
    return 0;
}
