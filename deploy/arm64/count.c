/* A plugin of QEMU: how many of the guest's instructions were run, of all threads, told at the end. docs/arm.md has figures.

    gcc -O2 -shared -fPIC -o count.so count.c
    qemu-aarch64 -cpu cortex-a72 -L ROOT -plugin ./count.so ROOT/usr/bin/python3 ...    (of qemu-user; ROOT: try.sh's)

Declared here as in qemu-plugin.h of QEMU 7, which Debian has no package of. */
#include <inttypes.h>
#include <stdio.h>

typedef uint64_t qemu_plugin_id_t;
struct qemu_plugin_tb;
extern size_t qemu_plugin_tb_n_insns(const struct qemu_plugin_tb *tb);
extern void qemu_plugin_register_vcpu_tb_trans_cb(qemu_plugin_id_t id, void (*)(qemu_plugin_id_t, struct qemu_plugin_tb *));
extern void qemu_plugin_register_vcpu_tb_exec_cb(struct qemu_plugin_tb *tb, void (*)(unsigned, void *), int flags, void *data);
extern void qemu_plugin_register_atexit_cb(qemu_plugin_id_t id, void (*)(qemu_plugin_id_t, void *), void *data);

__attribute__((visibility("default"))) int qemu_plugin_version = 1;
static uint64_t counts[1024][8]; /* a cache line a thread */

static void ran(unsigned thread, void *many) { counts[thread & 1023][0] += (uintptr_t)many; }

static void translated(qemu_plugin_id_t id, struct qemu_plugin_tb *tb)
{
    qemu_plugin_register_vcpu_tb_exec_cb(tb, ran, 0, (void *)qemu_plugin_tb_n_insns(tb));
}

static void ended(qemu_plugin_id_t id, void *data)
{
    uint64_t sum = 0;
    for (int i = 0; i < 1024; i++) sum += counts[i][0];
    fprintf(stderr, "%" PRIu64 " instructions\n", sum);
}

__attribute__((visibility("default"))) int qemu_plugin_install(qemu_plugin_id_t id, const void *info, int argc, char **argv)
{
    qemu_plugin_register_vcpu_tb_trans_cb(id, translated);
    qemu_plugin_register_atexit_cb(id, ended, NULL);
    return 0;
}
