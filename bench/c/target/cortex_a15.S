/* Cortex-A15 with the high byte first (BE8) on the board virt that QEMU emulates: start, semihosting. QEMU starts it in
 * that order because the program's header says so; what is handed to the host has the low byte first. */
    .syntax unified
    .arm
    .equ SEMIHOSTING_EXIT, 0x20
    .equ APPLICATION_EXIT, 0x20026

    .section .vectors, "ax"
    .global target_start
target_start:
    ldr sp, =target_stack_top
    ldr r0, =target_vectors
    mcr p15, 0, r0, c12, c0, 0      /* exceptions come there */
    mrc p15, 0, r0, c1, c0, 2
    orr r0, r0, #(0xf << 20)        /* the FPU: coprocessors 10 and 11, full access */
    mcr p15, 0, r0, c1, c0, 2
    isb
    mov r0, #(1 << 30)
    vmsr fpexc, r0
    bl target_main
    b leave

    .balign 32
target_vectors:                     /* none is expected */
    .rept 8
    b target_fault
    .endr
target_fault:
    mov r0, #100
leave:                              /* with exit code r0 */
    ldr r2, =APPLICATION_EXIT
    mov r3, r0
    push {r2, r3, r4}
    mov r1, sp
    mov r0, #SEMIHOSTING_EXIT
    bl target_host
    b .

    .text
/* int target_host(int operation, void *arguments): semihosting, with three words of arguments. */
    .global target_host
    .type target_host, %function
target_host:
    push {r4, lr}
    sub sp, sp, #16
    ldr r2, [r1]
    ldr r3, [r1, #4]
    ldr r4, [r1, #8]
    rev r2, r2
    rev r3, r3
    rev r4, r4
    stm sp, {r2, r3, r4}
    mov r1, sp
    svc 0x123456
    add sp, sp, #16
    pop {r4, pc}
