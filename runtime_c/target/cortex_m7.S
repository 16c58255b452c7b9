/* Cortex-M7 on the board mps2-an500 that QEMU emulates: vectors, start, counter, semihosting, switch of the stack. */
    .syntax unified
    .cpu cortex-m7
    .thumb

    .equ CPACR, 0xe000ed88          /* access to the coprocessors */
    .equ TIMER, 0x40000000          /* first CMSDK timer; counts down at 25 MHz of emulated time */
    .equ TIMER_VALUE, 4
    .equ TIMER_RELOAD, 8
    .equ TIMER_STATUS, 12           /* 1 once the timer has run out; writing 1 clears it */
    .equ TIMER_ENABLE, 0x9          /* with the status; no interrupt gets past the NVIC */
    .equ SEMIHOSTING_EXIT, 0x20
    .equ APPLICATION_EXIT, 0x20026

    .section .vectors, "a"
    .word target_stack_top
    .word target_start
    .rept 14                        /* NMI, faults and exceptions: none is expected */
    .word target_fault
    .endr

    .text
    .thumb_func
    .global target_start
    .type target_start, %function
target_start:
    ldr r0, =CPACR
    ldr r1, [r0]
    orr r1, r1, #(0xf << 20)        /* the FPU: coprocessors 10 and 11, full access */
    str r1, [r0]
    dsb
    isb
    ldr r0, =TIMER
    mov r1, #-1
    str r1, [r0, #TIMER_RELOAD]
    mov r1, #TIMER_ENABLE
    str r1, [r0]
    bl target_main
    b leave

    .thumb_func
    .type target_fault, %function
target_fault:
    mrs r0, ipsr                    /* number of the exception */
    add r0, r0, #100
leave:                              /* with exit code r0 */
    ldr r1, =APPLICATION_EXIT
    push {r1, r2}
    str r0, [sp, #4]
    mov r1, sp
    mov r0, #SEMIHOSTING_EXIT
    bkpt 0xab
    b .

/* int target_host(int operation, void *arguments): semihosting. */
    .thumb_func
    .global target_host
    .type target_host, %function
target_host:
    bkpt 0xab
    bx lr

/* uint32_t target_measure(void (*work)(void), void *stack_top): ticks of the counter while work runs on that stack. */
    .thumb_func
    .global target_measure
    .type target_measure, %function
target_measure:
    push {r4, r5, r6, lr}
    mov r4, sp
    mov sp, r1
    ldr r5, =TIMER
    mov r6, #1
    str r6, [r5, #TIMER_STATUS]
    mov r6, #-1
    str r6, [r5, #TIMER_VALUE]
    blx r0
    ldr r0, [r5, #TIMER_VALUE]
    ldr r1, [r5, #TIMER_STATUS]
    mov sp, r4
    mvn r0, r0                      /* it counts down from the largest value */
    cmp r1, #0
    it ne
    movne r0, #-1
    pop {r4, r5, r6, pc}

/* void target_nothing(void): one instruction, the return. */
    .thumb_func
    .global target_nothing
    .type target_nothing, %function
target_nothing:
    bx lr

/* void target_loop(void): 2 + 2 target_loop_count instructions, and the return. */
    .thumb_func
    .global target_loop
    .type target_loop, %function
target_loop:
    ldr r0, =target_loop_count
    ldr r0, [r0]
1:  subs r0, r0, #1
    bne 1b
    bx lr
