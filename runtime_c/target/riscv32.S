/* RV32IMAFC on the board virt that QEMU emulates: start, counter, semihosting, switch of the stack. */
    .equ SEMIHOSTING_EXIT, 0x20
    .equ APPLICATION_EXIT, 0x20026
    .equ MSTATUS_FS, 1 << 13

    .section .vectors, "ax"
    .global target_start
target_start:
    la sp, target_stack_top
    la t0, target_fault
    csrw mtvec, t0
    li t0, MSTATUS_FS               /* the FPU */
    csrs mstatus, t0
    call target_main
    j leave

    .balign 4
target_fault:
    csrr a0, mcause
    addi a0, a0, 100
leave:                              /* with exit code a0 */
    addi sp, sp, -16
    li t0, APPLICATION_EXIT
    sw t0, 0(sp)
    sw a0, 4(sp)
    mv a1, sp
    li a0, SEMIHOSTING_EXIT
    call target_host
    j .

    .text
/* int target_host(int operation, void *arguments): semihosting. Its three instructions are whole words, on one page. */
    .global target_host
    .balign 16
target_host:
    .option push
    .option norvc
    slli zero, zero, 0x1f
    ebreak
    srai zero, zero, 7
    .option pop
    ret

/* uint32_t target_measure(void (*work)(void), void *stack_top): ticks of the counter while work runs on that stack. */
    .global target_measure
target_measure:
    addi sp, sp, -16
    sw ra, 12(sp)
    sw s0, 8(sp)
    sw s1, 4(sp)
    sw s2, 0(sp)
    mv s0, sp
    mv sp, a1
    csrr s2, minstreth
    csrr s1, minstret
    jalr a0
    csrr a0, minstret
    csrr a1, minstreth
    mv sp, s0
    sltu t0, a0, s1
    sub a0, a0, s1
    sub a1, a1, s2
    beq a1, t0, 1f                  /* the upper word of the difference is zero */
    li a0, -1
1:  lw ra, 12(sp)
    lw s0, 8(sp)
    lw s1, 4(sp)
    lw s2, 0(sp)
    addi sp, sp, 16
    ret

/* void target_nothing(void): one instruction, the return. */
    .global target_nothing
target_nothing:
    ret

/* void target_loop(void): 2 + 2 target_loop_count instructions, and the return. */
    .global target_loop
target_loop:
    .option push
    .option norelax                 /* lui and lw, whatever the linker finds near */
    lui a0, %hi(target_loop_count)
    lw a0, %lo(target_loop_count)(a0)
1:  addi a0, a0, -1
    bnez a0, 1b
    ret
    .option pop
