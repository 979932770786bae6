"""The board of programs for other processors: what they are to do stands in a register of the chip."""

from stage import Stage
from stage.board import Board
from stage.chips import PCL240K


def board_of(case: int = 0, chips=PCL240K) -> Board:
    """A board whose chip has the case in the upper byte of R0, and a speed."""
    board = Board(Stage("xy", chips=chips, visuals=False))
    for register, value in ((1, 800), (7, 300), (0, case << 16)):
        board.out8(0x300, 0x80 | register)
        for byte in (2, 1, 0):
            board.out8(0x301 + byte, value >> 8 * byte & 0xFF)
    return board
