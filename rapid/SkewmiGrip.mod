MODULE SkewmiGrip
!=====================================================================================
! The right SmartGripper for skewmi: load it into the task T_SKEWMI_GRIP of sys.cfg.
!
! EGMRunJoint blocks the motion task, so the gripper has a task of its own. The bridge
! sets skewmi_target by Robot Web Services and reads skewmi_state, ten times a second.
! Needs ABB's SmartGripper add-in, whose HandDriver is loaded into all tasks.
!=====================================================================================

    ! Travel of each finger from closed, asked for [mm, 0..25].
    PERS num skewmi_target := 14;

    ! Travel of each finger [mm]; whether it is calibrated (0, 1); the gripper's error
    ! number (0 for none); rounds of this task, by which the bridge sees that it runs.
    PERS num skewmi_state{4} := [0, 0, 0, 0];

    LOCAL VAR num asked := -1;

    PROC main()
        asked := -1;
        Hand_Initialize \maxSpd:=20, \holdForce:=10;
        WHILE TRUE DO
            Follow;
            Tell;
            WaitTime 0.1;
        ENDWHILE
    ENDPROC

    LOCAL PROC Follow()
        VAR num target;

        target := skewmi_target;
        IF target <> asked AND target >= 0 AND target <= 25 AND Hand_IsCalibrated() THEN
            asked := target;
            Hand_MoveTo target \NoWait;
        ENDIF
    ERROR
        ! Told through skewmi_state; the next target is tried again.
        TRYNEXT;
    ENDPROC

    LOCAL PROC Tell()
        skewmi_state{1} := Hand_GetActualPos();
        IF Hand_IsCalibrated() THEN
            skewmi_state{2} := 1;
        ELSE
            skewmi_state{2} := 0;
        ENDIF
        skewmi_state{3} := Hand_GetFingerErrID();
        skewmi_state{4} := (skewmi_state{4} + 1) MOD 1000000;
    ERROR
        ! No contact to the gripper: the rounds stand still, and the bridge says so.
        TRYNEXT;
    ENDPROC
ENDMODULE
