/* The operations for CAN as packed structs, by the tables of FMI-LS-BUS. Prints one operation a line, in hexadecimal. */
#include <stdint.h>
#include <stdio.h>
#include <string.h>

#pragma pack(1)
struct head { uint32_t code, length; };
struct format_error { struct head head; uint16_t data_length; uint8_t data[3]; };
struct can { struct head head; uint32_t id; uint8_t ide, rtr; uint16_t data_length; uint8_t data[8]; };
struct can_fd { struct head head; uint32_t id; uint8_t ide, brs, esi; uint16_t data_length; uint8_t data[64]; };
struct can_xl {
    struct head head;
    uint32_t id;
    uint8_t ide, sec, sdt, vcid;
    uint32_t af;
    uint16_t data_length;
    uint8_t data[2048];
};
struct identified { struct head head; uint32_t id; };
struct bus_error { struct head head; uint32_t id; uint8_t code, flag, is_sender; };
struct baud_rate { struct head head; uint8_t parameter; uint32_t rate; };
struct arbitration { struct head head; uint8_t parameter, behavior; };
struct status { struct head head; uint8_t status; };

static void print(const void *operation) {
    uint32_t length;
    memcpy(&length, (const char *)operation + sizeof length, sizeof length);
    for (uint32_t i = 0; i < length; i++)
        printf("%02x", ((const unsigned char *)operation)[i]);
    puts("");
}

int main(void) {
    struct format_error format_error = {{0x01, 13}, 3, {7, 8, 9}};
    struct can standard = {{0x10, 16 + 8}, 0x7ff, 0, 0, 8, {1, 2, 3, 4, 5, 6, 7, 8}};
    struct can extended = {{0x10, 16}, 0x1ffffffe, 1, 0, 0, {0}};
    struct can remote = {{0x10, 16}, 0x123, 0, 1, 4, {0}};
    struct can_fd can_fd = {{0x11, 17 + 64}, 0x100, 0, 1, 0, 64, {0}};
    struct can_fd passive = {{0x11, 17 + 12}, 0x10000, 1, 0, 1, 12, {0}};
    struct can_xl can_xl = {{0x12, 22 + 2048}, 0x345, 0, 1, 5, 6, 0x89abcdef, 2048, {0}};
    struct identified confirm = {{0x20, 12}, 0x123};
    struct identified lost = {{0x30, 12}, 0x1fffffff};
    struct bus_error bus_error = {{0x31, 15}, 0x123, 4, 1, 1};
    struct bus_error elsewhere = {{0x31, 15}, 0x123, 6, 2, 0};
    struct baud_rate rate = {{0x40, 13}, 1, 500000};
    struct baud_rate fd_rate = {{0x40, 13}, 2, 2000000};
    struct baud_rate xl_rate = {{0x40, 13}, 3, 10000000};
    struct arbitration keep = {{0x40, 10}, 4, 1};
    struct arbitration discard = {{0x40, 10}, 4, 2};
    struct status active = {{0x41, 9}, 1}, off = {{0x41, 9}, 3};
    struct head wakeup = {0x42, 8};
    for (int i = 0; i < 64; i++)
        can_fd.data[i] = (uint8_t)(i + 1);
    for (int i = 0; i < 12; i++)
        passive.data[i] = (uint8_t)(i + 1);
    for (int i = 0; i < 2048; i++)
        can_xl.data[i] = (uint8_t)(i + 1);
    const void *all[] = {&format_error, &standard, &extended, &remote, &can_fd, &passive, &can_xl,
                         &confirm, &lost, &bus_error, &elsewhere, &rate, &fd_rate, &xl_rate,
                         &keep, &discard, &active, &off, &wakeup};
    for (size_t i = 0; i < sizeof all / sizeof *all; i++)
        print(all[i]);
    return 0;
}
