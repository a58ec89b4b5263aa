"""Recordings as programs of laboratories write them: python3 tests/exchange/instruments.py OUT

Every file holds the same twelve samples (r = i/4, u = 9/8 - i/2, y = i*i/16, every 0.02 s unless it says otherwise) in the
form that the program is documented to write, written here by hand: titles, settings, rows of units, counters, columns of
other things, marks for what was not seen. None is somebody's recording. tests/trials/instruments.rs says what is made of each.
"""

import os
import struct
import sys

N = 12
R = [0.25 * i for i in range(N)]
U = [1.125 - 0.5 * i for i in range(N)]
Y = [0.0625 * i * i for i in range(N)]
T = [0.02 * i for i in range(N)]
FILES = {}


def rows(form, **more):
    """One line a sample; `form` takes i, t (seconds), r, u, y and what else is given as functions of i."""
    return "".join(form.format(i=i, n=i + 1, t=T[i], ms=20 * i, r=R[i], u=U[i], y=Y[i], **{k: f(i) for k, f in more.items()})
                   for i in range(N))


def comma(text):
    return text.replace(".", ",")


def put(name, text, encoding="utf-8"):
    FILES[name] = text if isinstance(text, bytes) else text.encode(encoding)


def labview():
    head = ("LabVIEW Measurement\t\nWriter_Version\t2\nReader_Version\t2\nSeparator\tTab\nDecimal_Separator\t{0}\n"
            "Multi_Headings\tYes\nX_Columns\tOne\nTime_Pref\tRelative\nOperator\tlab\nDate\t2024/05/01\n"
            "Time\t10:22:31{0}5231231866455078125\n***End_of_Header***\t\n\t\nChannels\t3\t\t\t\nSamples\t12\t12\t12\t\n"
            "Date\t2024/05/01\t2024/05/01\t2024/05/01\t\nTime\t10:22:31{0}52\t10:22:31{0}52\t10:22:31{0}52\t\n"
            "Y_Unit_Label\tdeg\tN\tdeg\t\nX_Dimension\tTime\tTime\tTime\t\n"
            "X0\t0{0}0000000000000000E+0\t0{0}0000000000000000E+0\t0{0}0000000000000000E+0\t\n"
            "Delta_X\t0{0}020000\t0{0}020000\t0{0}020000\t\n***End_of_Header***\t\t\t\t\n"
            "X_Value\tTarget\tStick\tCursor\tComment\n")
    body = rows("{t:.6f}\t{r:.6f}\t{u:.6f}\t{y:.6f}\n").replace("\n", "\r\n")
    put("labview.lvm", head.format(".").replace("\n", "\r\n") + body)
    put("labview_de.lvm", head.format(",").replace("\n", "\r\n") + comma(body))
    put("labview_spreadsheet.txt", rows("{t:.3f}\t{r:.3f}\t{u:.3f}\t{y:.4f}\n"))


def matlab():
    put("simulink_timetable.csv", "Time,r,u,y\n" + rows("{t:.2g} sec,{r:g},{u:g},{y:g}\n"))
    put("simulink_table.csv", "t,yout_1,yout_2,yout_3\n" + rows("{t:.15g},{r:.15g},{u:.15g},{y:.15g}\n"))
    put("matlab_dlmwrite.txt", rows("   {t:.7e}   {r:.7e}   {u:.7e}   {y:.7e}\n"))
    put("matlab_display.txt", "\nM =\n\n   1.0e+03 *\n\n" + rows("    {t:.4f}    {r:.4f}    {u:.4f}    {y:.4f}\n"))
    put("simulink_sideways.csv", "".join(
        name + "," + ",".join(f"{x:g}" for x in values) + "\n" for name, values in zip("truy", (T, R, U, Y))))


def eyes():
    head = ("Recording timestamp [\u03bcs]\tComputer timestamp [\u03bcs]\tSensor\tProject name\tParticipant name\tRecording name\t"
            "Gaze point X [DACS px]\tGaze point Y [DACS px]\tPupil diameter left [mm]\tValidity left\tEye movement type\tEvent\n")
    put("tobii.tsv", head + rows("{us}\t{late}\tEye Tracker\tPursuit\tP01\tRecording1\t{r:g}\t{y:g}\t{u:g}\tValid\tFixation\t\n",
                                 us=lambda i: 20000 * i, late=lambda i: 91182736455 + 20000 * i), "utf-16")
    head = ("** CONVERTED FROM pursuit.edf using edfapi 4.2.1 Linux on Wed May  1 10:22:31 2024\n** DATE: Wed May  1 10:20:02 2024\n"
            "** TYPE: EDF_FILE BINARY EVENT SAMPLE TAGGED\n** VERSION: EYELINK II 1\n** SOURCE: EYELINK CL\n**\n\n"
            "MSG\t5001200 DISPLAY_COORDS 0 0 1919 1079\nSTART\t5001228 \tRIGHT\tSAMPLES\tEVENTS\nPRESCALER\t1\nVPRESCALER\t1\n"
            "PUPIL\tAREA\nEVENTS\tGAZE\tRIGHT\tRATE\t1000.00\tTRACKING\tCR\tFILTER\t2\n"
            "SAMPLES\tGAZE\tRIGHT\tRATE\t1000.00\tTRACKING\tCR\tFILTER\t2\tINPUT\n")
    body = rows("{stamp}\t {r:7.4f}\t {u:7.4f}\t {y:7.4f}\t...\n", stamp=lambda i: 5001230 + i).splitlines(True)
    body[4:4] = ["SFIX R   5001233\n", "MSG\t5001234 -3 TARGET_ON\n"]
    body[9:9] = ["EFIX R   5001233\t5001237\t5\t  512.3\t  384.1\t   1023\n"]
    foot = "END\t5001242 \tSAMPLES\tEVENTS\tRES\t  38.54\t  31.12\n"
    put("eyelink.asc", head + "".join(body) + foot)
    lost = [line.replace(" 0.5000", "   .").replace(" 0.1250", "   .").replace(" 0.2500\t...", "   .\t...") if k == 2 else line
            for k, line in enumerate(body)]
    put("eyelink_blink.asc", head + "".join(lost) + foot)
    put("smi_begaze.txt", "## [BeGaze]\n## Converted from:\tC:\\data\\p01.idf\n## Date:\t01.05.2024 10:22:31\n## Sample Rate:\t50\n"
        "Time\tType\tTrial\tL POR X [px]\tL POR Y [px]\tR POR X [px]\n"
        + rows("{us}\tSMP\t1\t{r:.4f}\t{u:.4f}\t{y:.4f}\n", us=lambda i: 8812000000 + 20000 * i))
    put("pupil_labs.csv", "gaze_timestamp,world_index,confidence,norm_pos_x,norm_pos_y,base_data,target_x\n"
        + rows("{s:.6f},{i},0.98,{u:.6f},{y:.6f},{s:.6f}-0 {s:.6f}-1,{r:g}\n", s=lambda i: 3187.25 + T[i]))


def motion():
    put("vicon_nexus.csv", "Devices\n50\n,,Target,Stick,Cursor\nFrame,Sub Frame,r,u,y\n,,V,V,V\n" + rows("{n},0,{r:g},{u:g},{y:g}\n"))
    put("vicon_two_blocks.csv", "Devices\n50\n,,Target,Stick,Cursor\nFrame,Sub Frame,r,u,y\n,,V,V,V\n" + rows("{n},0,{r:g},{u:g},{y:g}\n")
        + "\nTrajectories\n50\n,,lab:HAND,,\nFrame,Sub Frame,X,Y,Z\n,,mm,mm,mm\n" + rows("{n},0,{r:g},{u:g},{y:g}\n"))
    put("ndi_first_principles.txt", "Number of Frames:\t12\nNumber of Markers:\t1\nFrequency:\t50\nUnits:\tmm\n\n"
        "Frame\tMarker_1 x\tMarker_1 y\tMarker_1 z\n" + rows("{n}\t{r:.6f}\t{u:.6f}\t{y:.6f}\n"))
    put("ndi_unseen.csv", "Frame,Marker_1 x,Marker_1 y,Marker_1 z\n"
        + rows("{n},{r:.6f},{u:.6f},{y:.6f}\n").replace("7,1.500000,-1.875000,2.250000", "7,-3.697314E28,-3.697314E28,-3.697314E28"))
    head = ("NO_OF_FRAMES\t12\nNO_OF_CAMERAS\t8\nNO_OF_MARKERS\t1\nFREQUENCY\t50\nNO_OF_ANALOG\t0\nANALOG_FREQUENCY\t0\nDESCRIPTION\t--\n"
            "TIME_STAMP\t2024-05-01, 10:22:31.523\t36421.52312\nDATA_INCLUDED\t3D\nMARKER_NAMES\thandle\nTRAJECTORY_TYPES\tMeasured\n")
    put("qualisys.tsv", head + "Frame\tTime\thandle X\thandle Y\thandle Z\n" + rows("{n}\t{t:.5f}\t{r:.3f}\t{u:.3f}\t{y:.4f}\n"))
    put("qualisys_no_names.tsv", head + rows("{r:.3f}\t{u:.3f}\t{y:.4f}\n"))
    put("optitrack.csv", "Format Version,1.23,Take Name,pursuit 3,Capture Frame Rate,50.000000,Export Frame Rate,50.000000,Total Frames,12\n\n"
        ",Type,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body\n,Name,target,target,target,hand,hand,hand\n"
        ",ID,1,1,1,2,2,2\n,,Position,Position,Position,Position,Position,Position\nFrame,Time (Seconds),X,Y,Z,X,Y,Z\n"
        + rows("{i},{t:.6f},{r:.6f},0.000000,0.000000,{u:.6f},{y:.6f},0.000000\n"))
    put("opensim.mot", "pursuit\nversion=1\nnRows=12\nnColumns=4\ninDegrees=yes\nendheader\ntime\ttarget\tforce\telbow_flexion\n"
        + rows("\t{t:.8f}\t{r:.8f}\t{u:.8f}\t{y:.8f}\n").replace("\n\t", "\n").lstrip("\t"))
    put("opensim.trc", "PathFileType\t4\t(X/Y/Z)\tpursuit.trc\nDataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\t"
        "OrigDataStartFrame\tOrigNumFrames\n50.00\t50.00\t12\t1\tmm\t50.00\t1\t12\nFrame#\tTime\thand\t\t\n\t\tX1\tY1\tZ1\n\n"
        + rows("{n}\t{t:.5f}\t{r:.5f}\t{u:.5f}\t{y:.5f}\n"))
    put("visual3d.txt", "\tpursuit.c3d\tpursuit.c3d\tpursuit.c3d\n\tTARGET\tFP1\tHAND\n\tDERIVED\tFORCE\tTARGET\n\tPROCESSED\tORIGINAL\tORIGINAL\n"
        "ITEM\tX\tX\tX\n" + rows("{n}\t{r:.5f}\t{u:.5f}\t{y:.5f}\n"))
    put("xsens.txt", "// Start Time: 01/05/2024 10:22:31\n// Update Rate: 50.0Hz\n// Filter Profile: human (46.1)\n// Firmware Version: 4.6.0\n"
        "PacketCounter\tSampleTimeFine\tRoll\tPitch\tYaw\n" + rows("{k}\t{fine}\t{r:.6f}\t{u:.6f}\t{y:.6f}\n",
                                                            k=lambda i: 4711 + i, fine=lambda i: 92233 + 200 * i))
    put("kinarm.csv", "Time (s),Right: Hand position X (m),Right: Hand force X (N),Target X (m),Event code\n"
        + rows("{t:.3f},{y:.8f},{u:.8f},{r:.8f},{e}\n", e=lambda i: 21 if i == 0 else 0))


def rigs():
    head = ('"ControlDesk Next Generation Export",,,,\n"type","float","float","float","float"\n"description","","","",""\n'
            '"path","","Model Root/Target/Out1","Model Root/Stick/Out1","Model Root/Cursor/Out1"\n"unit","s","deg","N","deg"\n')
    body = rows(",{t:.3f},{r:.5f},{u:.5f},{y:.5f}\n")
    put("dspace.csv", head + '"trace_values"' + body)
    put("diadem.csv", "Zeit;Ziel;Kraft;Ort\ns;deg;N;deg\n" + comma(rows("{t:.3f};{r:.5f};{u:.5f};{y:.5f}\n")), "latin-1")
    put("spike2_channels.txt", '"INFORMATION"\n"pursuit.smr"\n\n"SUMMARY"\n"1"\t"Waveform"\t"Target"\t"deg"\t50\t50\t1\t0\n\n"CHANNEL"\t"1"\n'
        '"Waveform"\n"Target"\n"deg"\n50\n"START"\t0.00000\t0.02000\n' + rows("{r:.5f}\n"))
    put("spike2_sheet.txt", '"Time"\t"1 Target"\t"2 Stick"\t"3 Cursor"\n' + rows("{t:.5f}\t{r:.5f}\t{u:.5f}\t{y:.5f}\n"))
    head = ("Interval=\t0.02 s\nExcelDateTime=\t4.5413432306e+04\t01/05/2024 10:22:31.523\nTimeFormat=\tStartOfBlock\nDateFormat=\t\n"
            "ChannelTitle=\tTarget\tStick\tCursor\nRange=\t10.000 V\t10.000 V\t10.000 V\n")
    put("labchart.txt", head + rows("{t:g}\t{r:g}\t{u:g}\t{y:g}\n"))
    put("labchart_values.txt", head + "TopValue=\t10\t10\t10\nBottomValue=\t-10\t-10\t-10\n" + rows("{t:g}\t{r:g}\t{u:g}\t{y:g}\n"))
    head = "pursuit.acq\n20 msec/sample\n3 channels\nTarget\ndeg\nStick\nN\nCursor\ndeg\n{0}\tCH1\tCH2\tCH3\t\n\t12\t12\t12\t\n"
    put("acqknowledge.txt", head.format("sec") + rows("{t:.5f}\t{r:.5f}\t{u:.5f}\t{y:.5f}\t\n"))
    put("acqknowledge_minutes.txt", head.format("min") + rows("{m:.8f}\t{r:.5f}\t{u:.5f}\t{y:.5f}\t\n", m=lambda i: T[i] / 60))
    put("delsys.csv", 'X[s],"Trigno 1: EMG 1 (IM) [Volts]",X[s],"Trigno 1: ACC X 1 (IM) [g]",X[s],"Trigno 2: EMG 2 (IM) [Volts]"\n'
        + rows("{t:.4f},{r:.6f},{t:.4f},{u:.6f},{t:.4f},{y:.6f}\n"))
    put("opensignals.txt", "# OpenSignals Text File Format\n"
        '# {"00:07:80:3B:46:61": {"sensor": ["RAW", "RAW", "RAW"], "device name": "00:07:80:3B:46:61", "column": ["nSeq", "DI", "CH1", '
        '"CH2", "CH3"], "sync interval": 2, "time": "10:22:31.523", "date": "2024-5-1", "sampling rate": 50, "label": ["CH1", "CH2", "CH3"]}}\n'
        "# EndOfHeader\n" + rows("{q}\t0\t{r:g}\t{u:g}\t{y:g}\t\n", q=lambda i: i % 8))
    put("openbci.txt", "%OpenBCI Raw EXG Data\n%Number of channels = 3\n%Sample Rate = 50 Hz\n%Board = OpenBCI_GUI$BoardCytonSerial\n"
        "Sample Index, EXG Channel 0, EXG Channel 1, EXG Channel 2, Other, Timestamp, Timestamp (Formatted)\n"
        + rows("{q:.1f}, {r:g}, {u:g}, {y:g}, 192.0, {s:.6f}, 2024-05-01 10:22:31.523\n", q=lambda i: i % 8, s=lambda i: 1714558951.5 + T[i]))
    put("shimmer.csv", "Shimmer_3A\tShimmer_3A\tShimmer_3A\tShimmer_3A\t\nTimestamp_Unix\tTarget\tStick\tCursor\t\nCAL\tCAL\tCAL\tCAL\t\n"
        "ms\tm/(s^2)\tm/(s^2)\tm/(s^2)\t\n" + rows("{s:.1f}\t{r:g}\t{u:g}\t{y:g}\t\n", s=lambda i: 1714558951523 + 20 * i))
    put("bioware.txt", "BioWare Data File: C:\\data\\pursuit.dat\nDate:\t01.05.2024\nScan rate:\t50\n\nabs time (s)\tFx\tFy\tMz\ns\tN\tN\tN.m\n"
        + rows("{t:.6f}\t{r:.6f}\t{u:.6f}\t{y:.6f}\n"))
    put("capstone.txt", "Time (ms) Run #1\tTarget (mm) Run #1\tForce (N) Run #1\tPosition (mm) Run #1\n" + rows("{ms}\t{r:g}\t{u:g}\t{y:g}\n"))
    put("phyphox.csv", '"Time (s)","Acceleration x (m/s^2)","Acceleration y (m/s^2)","Acceleration z (m/s^2)"\n'
        + rows("{t:.9E},{r:.9E},{u:.9E},{y:.9E}\n"))
    put("haptics.log", rows("t: {t:.3f} ref: {r:.4f} force: {u:.4f} pos: {y:.4f}\n"))
    put("haptics_vectors.log", rows("{t:.3f} [{r:.4f} {u:.4f} {y:.4f}]\n"))
    put("fortran.dat", "".join(
        " " + " ".join(f"{x:.6E}".replace("E", "D") for x in (T[i], R[i], U[i], Y[i])) + "\n" for i in range(N)))


def programs():
    put("psychopy.csv", "participant,session,date,expName,psychopyVersion,block,condition,key,corr,t,r,u,y,notes\n"
        + rows("s01,1,2024-05-01_10h22.31,pursuit,2024.1.4,left,slow,None,True,{t:.4f},{r:g},{u:g},{y:g},\n"))
    put("psychopy_lists.csv", "participant,trials.thisN,mouse.x,mouse.y,mouse.time\ns01,0,\"[0.0, 0.25]\",\"[1.125, 0.625]\",\"[0.0, 0.02]\"\n")
    put("presentation.log", "Scenario - pursuit\nLogfile written - 05/01/2024 10:22:31\n\n"
        "Subject\tTrial\tEvent Type\tCode\tTime\tTTime\n" + rows("s01\t{n}\tPicture\ttarget\t{k}\t0\n", k=lambda i: 123450 + 200 * i))
    put("eprime.txt", "*** Header Start ***\nVersionPersist: 1\nLevelName: Session\nSubject: 1\n*** Header End ***\n\tLevel: 2\n", "utf-16")
    put("excel_us.csv", "t,r,u,y\r\n" + rows("{t:.2f},{r:.3f},{u:.3f},{y:.4f}\n").replace("\n", "\r\n").replace(",2.000,", ',"1,234.500",'))
    put("excel_dates.csv", "Time;r;u;y\r\n" + comma(rows("{c};{r};{u};{y}\n", c=lambda i: f"10:22:31,{20 * i:03d}")).replace("\n", "\r\n"))
    put("excel_fr.csv", "Temps (ms);Consigne;Commande;Curseur\r\n" + comma(rows("{ms};{r};{u};{y}\n")).replace("\n", "\r\n"), "cp1252")
    put("libreoffice.csv", '"t","r","u","y"\n' + rows('"{t:g}","{r:g}","{u:g}","{y:g}"\n'))
    put("write_csv2.csv", '"";"t";"r";"u";"y"\n' + comma(rows('"{n}";{t:g};{r:g};{u:g};{y:g}\n')))
    put("pandas_two_levels.csv", "signal,r,u,y\nunit,deg,N,deg\nt,,,\n" + rows("{t:g},{r:g},{u:g},{y:g}\n"))
    put("pandas_no_names.csv", ",0,1,2,3\n" + rows("{i},{t:g},{r:g},{u:g},{y:g}\n"))
    put("python_on_windows.csv", "t,r,u,y\r\r\n" + rows("{t:g},{r:g},{u:g},{y:g}\n").replace("\n", "\r\r\n"))
    put("octave_text.txt", "# Created by Octave 7.3.0, Wed May 01 10:22:31 2024 UTC <lab@rig>\n# name: M\n# type: matrix\n# rows: 12\n# columns: 4\n"
        + rows(" {t:g} {r:g} {u:g} {y:g}\n"))
    put("arduino.log", rows("10:22:31.{c:03d} -> {r:.2f},{u:.3f},{y:.4f}\n", c=lambda i: 20 * i))
    put("arduino_labels.log", rows("t:{t:.2f},r:{r:.2f},u:{u:.3f},y:{y:.4f}\n"))
    put("arduino_cut.log", "75,0.0625\n" + rows("{t:.2f},{r:.2f},{u:.3f},{y:.4f}\n"))
    put("rostopic.csv", "%time,field.header.seq,field.header.stamp,field.header.frame_id,field.target,field.stick,field.cursor\n"
        + rows("{s},{i},{s},base,{r:g},{u:g},{y:g}\n", s=lambda i: 1714558951523000000 + 20_000_000 * i))
    put("unity_de.csv", "t,r,u,y\n" + rows("{a},{b},{c},{d}\n", a=lambda i: comma(f"{T[i]:.3f}"), b=lambda i: comma(f"{R[i]:.3f}"),
                                           c=lambda i: comma(f"{U[i]:.3f}"), d=lambda i: comma(f"{Y[i]:.3f}")))
    put("unity.csv", "frame;timeMs;target.x;input.x;cursor.x;scene\n" + rows("{i};{ms};{r:g};{u:g};{y:g};Pursuit\n"))
    put("samples.jsonl", rows('{{"t": {t:g}, "r": {r:g}, "u": {u:g}, "y": {y:g}}}\n'))
    put("records.json", "[" + rows('{{"t": {t:g}, "r": {r:g}, "u": {u:g}, "y": {y:g}}},\n').rstrip(",\n") + "]\n")
    put("markdown.md", "| t | r | u | y |\n|---|---|---|---|\n" + rows("| {t:g} | {r:g} | {u:g} | {y:g} |\n"))
    put("msvc.csv", "t,r,u,y\n" + rows("{t:g},{r:g},{u:g},{y:g}\n").replace("0.12,1.5,", "0.12,-1.#IND,"))
    put("long.csv", "t,signal,value\n" + rows("{t:g},r,{r:g}\n{t:g},u,{u:g}\n{t:g},y,{y:g}\n"))
    put("typeset.csv", "t,r,u,y\n" + rows("{t:g},{r:g},{u:g},{y:g}\n").replace("-", "\u2212"))
    put("excel_web.xls", "<html><head><meta charset=utf-8></head><body><table><tr><td>t</td></tr></table></body></html>\n")
    put("labview.tdms", b"TDSm" + struct.pack("<IIQQ", 0x0E, 4713, 256, 128))
    put("motion.c3d", b"\x02P" + bytes(30))
    put("recording.edf", b"0       " + b"X X X X".ljust(80) + b"Startdate 01-MAY-2024".ljust(80) + b"01.05.2410.22.31" + b"512".ljust(80))


def main():
    out = sys.argv[1]
    os.makedirs(out, exist_ok=True)
    for write in (labview, matlab, eyes, motion, rigs, programs):
        write()
    for name, data in FILES.items():
        with open(f"{out}/{name}", "wb") as file:
            file.write(data)


main()
