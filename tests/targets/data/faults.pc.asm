; What a program of DOS can do, right and wrong: which of it stands in the upper byte of R0 of the chip at 300h.
        org 100h
        mov dx, 303h
        in al, dx
        mov [what], al
        cmp al, 1
        je no_instruction
        cmp al, 2
        je divides
        cmp al, 3
        je halts
        cmp al, 4
        je key
        cmp al, 5
        je function
        cmp al, 6
        je interrupt
        cmp al, 7
        je ticks
        cmp al, 8
        je for_ever
        mov dx, text
        mov ah, 9
        int 21h
        mov al, [what]
        mov ah, 4Ch
        int 21h

no_instruction: db 0Fh, 0Bh
divides: xor cl, cl
        div cl
halts:  cli
        hlt
key:    mov ah, 8
        int 21h
function: mov ah, 5Fh
        int 21h
for_ever: jmp for_ever

interrupt:                      ; 30 pulses, IRQ5; returns the times that it came
        mov ax, 250Dh
        mov dx, routine
        int 21h
        in al, 21h
        and al, 0DFh
        out 21h, al
        mov si, bytes
        mov cx, 6
next:   lodsw
        mov dx, ax
        lodsb
        out dx, al
        loop next
        mov bx, 0
waits:  inc bx                  ; it is woken between any two of these
        cmp byte [seen], 0
        je waits
        mov al, [seen]
        mov ah, 4Ch
        int 21h
routine: push ax
        push dx
        inc byte [cs:seen]
        mov dx, 300h            ; lets go of the line
        xor al, al
        out dx, al
        mov al, 20h
        out 20h, al
        pop dx
        pop ax
        iret

ticks:                          ; the timer's routine comes 18.2 times a second
        mov ax, 251Ch
        mov dx, tick
        int 21h
wait5:  hlt
        cmp byte [seen], 5
        jb wait5
        mov ah, 0
        int 1Ah
        mov al, dl
        mov ah, 4Ch
        int 21h
tick:   inc byte [cs:seen]
        iret

what    db 0
seen    db 0
text    db 'it runs', 13, 10, '$'
bytes   dw 300h
        db 80h
        dw 303h
        db 0
        dw 302h
        db 0
        dw 301h
        db 30
        dw 300h
        db 44h
        dw 300h
        db 30h
