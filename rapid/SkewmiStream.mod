MODULE SkewmiStream
!=====================================================================================
! First stage: the bridge sees the arm, and nothing moves. Load it instead of SkewmiEgm.
!
! Positions are streamed (EGMStreamStart); references are not followed. The bridge says
! "EGM is not running (MCI stopped)" and publishes what it sees. RobotWare 7; whether
! RobotWare 6 has EGMStreamStart depends on its release: where the instruction is not
! known, the module cannot be loaded, and the first stage is SkewmiEgm with the bridge in
! `--limits careful` and nobody armed.
!=====================================================================================
    LOCAL VAR egmident skewmi_stream;

    PROC main()
        VAR string unit;

        unit := GetMecUnitName(ROB_ID);
        EGMReset skewmi_stream;
        EGMGetId skewmi_stream;
        EGMSetupUC ROB_ID, skewmi_stream, unit, unit \Joint;
        EGMStreamStart skewmi_stream;
        WHILE TRUE DO
            WaitTime 1;
        ENDWHILE
    ENDPROC
ENDMODULE
