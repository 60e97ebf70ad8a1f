MODULE SkewmiEgm
!=====================================================================================
! The program of both arms for skewmi's EGM bridge: load it into T_ROB_R and T_ROB_L.
!
! It stands still until the bridge answers, follows the bridge, and starts over whenever
! EGM ends: because nothing answered for SKEWMI_COMM_TIMEOUT, because the arm rested for
! SKEWMI_COND_TIME, or because somebody stopped and started the program.
!
! Needs: option 689-1 Externally Guided Motion; the UdpUc devices of sio.cfg and the
! External Motion Interface Data of moc.cfg beside this file, both named as the
! mechanical units (ROB_R, ROB_L). The manual is ABB's 3HAC073318.
!
! The numbers below are the ones that the bridge reckons with. Whoever changes one here
! tells the bridge (`skewmi robot --backend egm --help`).
!=====================================================================================

    ! Without an answer for so long EGMRunJoint ends with ERR_UDPUC_COMM [s]. Until then
    ! the arm goes on at the last speed: do not make it longer without need.
    LOCAL CONST num SKEWMI_COMM_TIMEOUT := 0.1;

    ! Low-pass on the speed [Hz], and the largest speed of a joint [deg/s]. ABB's default
    ! for the latter is 1: with it a motion takes hours.
    LOCAL CONST num SKEWMI_LP_FILTER := 20;
    LOCAL CONST num SKEWMI_MAX_SPEED_DEVIATION := 90;

    ! From the start of a session to full tracking [s].
    LOCAL CONST num SKEWMI_RAMP_IN_TIME := 0.1;

    ! Share of Default Proportional Position Gain in moc.cfg, 0..1.
    LOCAL CONST num SKEWMI_POS_CORR_GAIN := 1;

    ! A resting arm converges, and would end the session: hardly ever, and after an hour.
    LOCAL CONST egm_minmax SKEWMI_CONVERGENCE := [-0.001, 0.001];
    LOCAL CONST num SKEWMI_COND_TIME := 3600;

    ! What is on the flange: ABB's SmartGripper, servo module with two fingers, from ABB's
    ! own data. With another tool, or with a load in the hand, measure it (LoadIdentify):
    ! gravity and collision detection are reckoned with it.
    TASK PERS tooldata skewmi_tool := [TRUE, [[0, 0, 114.2], [1, 0, 0, 0]],
        [0.230, [8.2, 11.7, 52.0], [1, 0, 0, 0], 0.00021, 0.00024, 0.00009]];

    LOCAL VAR egmident skewmi_egm;

    PROC main()
        WHILE TRUE DO
            FollowBridge;
        ENDWHILE
    ENDPROC

    ! One session of EGM.
    LOCAL PROC FollowBridge()
        VAR string unit;

        unit := GetMecUnitName(ROB_ID);

        ! EGM starts from a fine point, and must not be the first motion after a restart.
        MoveAbsJ CJointT() \NoEOffs, v10, fine, skewmi_tool;

        EGMReset skewmi_egm;
        EGMGetId skewmi_egm;
        EGMSetupUC ROB_ID, skewmi_egm, unit, unit
            \Joint
            \CommTimeout:=SKEWMI_COMM_TIMEOUT;
        ! Axis 7 is the first external one on the wire, and J7 here: without its switch it
        ! does not move.
        EGMActJoint skewmi_egm
            \Tool:=skewmi_tool
            \J1:=SKEWMI_CONVERGENCE
            \J2:=SKEWMI_CONVERGENCE
            \J3:=SKEWMI_CONVERGENCE
            \J4:=SKEWMI_CONVERGENCE
            \J5:=SKEWMI_CONVERGENCE
            \J6:=SKEWMI_CONVERGENCE
            \J7:=SKEWMI_CONVERGENCE
            \LpFilter:=SKEWMI_LP_FILTER
            \MaxSpeedDeviation:=SKEWMI_MAX_SPEED_DEVIATION;

        ! Synchronous: with \NoWaitCond a missing answer is a fatal error instead of one
        ! that can be handled. EGM_STOP_HOLD: any other mode drives back to the start.
        EGMRunJoint skewmi_egm, EGM_STOP_HOLD
            \J1 \J2 \J3 \J4 \J5 \J6 \J7
            \CondTime:=SKEWMI_COND_TIME
            \RampInTime:=SKEWMI_RAMP_IN_TIME
            \PosCorrGain:=SKEWMI_POS_CORR_GAIN;
        EGMReset skewmi_egm;
    ERROR
        IF ERRNO = ERR_UDPUC_COMM THEN
            ! The bridge does not run, the cable is out, or it was late. Once a second is
            ! often enough to look for it again.
            TPWrite "skewmi: no answer to " + unit + "; trying again";
            WaitTime 1;
            TRYNEXT;
        ENDIF
    ENDPROC
ENDMODULE
