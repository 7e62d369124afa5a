"""Pickles of one small table, written by pandas itself: x, y, z, i, t as numbers, d as whole numbers; three points."""

from __future__ import annotations

import base64
import zlib

_SAMPLES = {
    "1.0.5, protocol 2": (
        "c-nPTX>-#s5OsQlVxZhNEu|DNS0GTJKxv_zts#K8%n^+2C{-YF@@yF>LuSe_Y3TqneB-b1nfx%2Wp$t&`rx<HuAcQ)yPECr8#E}<"
        "DCgHhmMe#}#>`7p&@0M<vHu-1O>|gJw_zA=NqW$^WJ@IwEDUHh%GGE<r&$=86V<x^;zl|%(IqLmts=74ANxw|HH&f{jhN{M?3Fv2"
        "te9B#|1cfV)5LPi>5>Oh=P~^tt~F-T_*z^Q6&i+g#&kpG*Mmreu`f)lNTW<it-M%i8!fEzUB6ypeq^#BF--J28A<G6wUd=trJ@q#"
        "v1Sfy3D(VHJ;4Uc&e+)&Hfq9>m}$s;o16|Ae{%$z7e35m3&B>)?o?cFv8_-jO#P5Uee7|8?cPEWJ1pgYjXs4l=vVj#I~7(ipip3!"
        "!V(6Vz-~_|59IY=s1VO#55Zpk@1%t^m}VwPzB+aLny@TBR8ZF$2^tFQw++P@iFyME<eAe6Yv7=rk^F}U4znV17GJ?t&W>=Ih@%Ag"
        "BoW<q=NyjlRDF2_#}oC#1Sb~NkK*J~^-|9%Z-MtZ?~TRL{x+T(UFTEmY0qlU7wuW2JsULc&^VxRP~(usVU1%F2R45Hc%uFFLb<$G"
        "TkX&7PlvRP5iYOyG{G5xv)-b}(M04qg0VzoCJ{NVMOH>|J`s6=U_y%If6Ke5<ZUs2jf}B$;8OC>%LG>hu6i=N*DSt_%etPlxVd<Q"
        "spJSY!F84A7H;sZvS<nx@8kV^Cm-OuWI5dQxT=C%1h-QP@*BmSgyJs2J*A?B`-<WLAEW|~-uaN=5o_YHs`sP0{BSOhCruR74x_S;"
        "@RVnj*Gn2Zf?LEhs|jkU#h0`i%NUR6ogO)@O^2=wi{SgN>%|q>j)Ci%QMKaBE-BfDESbza7(qF1V%p*!ALBkR$>nU~-~^SJ#gV}C"
        "w9;MKUwGjx*X^#JC{)$ltuaB>8&E4EP&G}32qV;+XvALbCv;nHTm"
    ),
    "1.0.5, protocol 4": (
        "c-nPSUuzRV5YINb7^_7K4YnYqiq=%h(Lx15vDHdJgAw{(j=kI_dw6#VyL&Ye1NzWvao;+AA3uPCZ-Sr1H=W(vK%#MB?>9HQ^XIoS"
        "^RDvwXSrmTUhLB>qS9~o1oJzBrVRAOr&Q4cE1$#0dl*4OdqIRs(5sX8<4iG;(M0+w&1jbi3HtJrq}P7+qWCZD8%OA1dD<{y119~D"
        "N{lxjWbAeD%;?a7U(()KHjyhu;Chy){b6CA=81}_5Oj#~0>Rq7Oe&GL6`E+zUIcvs!`Un6&@7$6J_+Fi973Z>n$;8Fb?rrJ*f$jQ"
        "+{^oL_OUoEYw{Lat=9A3xa_C7s~|ix9LNAPLD%FB?ijbi9Rb60UCGRQwenN+!WZ<)EV_bbUBma#-~>m$+0vd=R47bUSETCo0TV%i"
        "p+Kxph6(T`e$8;<D`O^JvwRACRnK*%7(D!oLCG-K9~3qJwOe3iufW=u0>3-`Ri|Hac-`Te!<!CoIoxsh2yw0c>E4gWozA+&Z(lbp"
        "0*3!LcQVdBp2(f=&B}ba<Q6GSFXP$1%mTk+9&&NU6XDMdQ$Bv1uk$;+!8c67@XcMV{%c8`CBI824A=;Cb<5x0@wbcqq*z+u^ST<E"
        "&X<6pjJ|qIliZv<(6zKH0zAa=sD*iq&6}a<$s}$w+n!iQVxs0I6V4BK%oEgAotEX&wpf4-i{ohqVmzur$`rK|a)chKQaFPn$V2}R"
        "q}g6W"
    ),
    "1.2.5, protocol 5": (
        "c-nPSUu)Dr5WlpS^K30z>CqOYRMC2s5-d~@6k9zN^ymqFFJY5xZi7kg*xlGWv7isFE$&;#ejY!7f^U8m-*k4f2iH;;HowX2&Y%6w"
        "%qRETjcUa#HQOh7M1&XiIQ3#qG79SQ3nIxYBcH(PXV{0Ps`^=%gIXHDp5&79oTS3bNKU$x3s6^{r@ipqcKKhLH+Ru~;jCdq2UK_g"
        "5g2aD&*`53TI<k&O)GaKo4^q!1FDf1S$|lXXGJO#!Z{gYJfG9BmkY^@P@;))%|%d`Fr2w^0`1BHw44CGzz#IqPP=vhtfAaU4*U9r"
        "YU1r9I6f**CzbONI-Sm&zqrh&y(u9$)^BhIpd57Ve88RHmbfFJc&@6srmIsNq8B!!7B6}(CwW)DcSqyc8`)Y%xk3^yF;!I+veySp"
        "1O<wMV|-Gb!1XZ_P^3HwK~4KH?`1&|$A<9c>7X*c{%n?5-72yEy~JNuf6eOWEZ(%ZZ1J|mI~F%AK1Ez^e0}))Ssbqz{P|<eAh0Dh"
        "5uc&-$vH|ZNLkx$PaYzHEs&bC$Ia7)%Gu?d`!|l0F~@A{0=JHK%UaTs#%9=6&G9UoWAnNb*y5-UT>QDEE6eV(6?Ts`*{ZH3mcy3u"
        "zm|@*WcSIK0o?~xd*H2ac<W{B60AC~DOC&fPzb<KT3>rl(n6oSRCSyx9}jVI>OqlUU*{;gB27YSIu}`Tbkss;!q_%TSc<xu)zU(k"
        "?(?yiad7pljE30Hs3c~1cF`k|630^~=*KDP8gZVaX>U*XQPIbEL{dK`0Zj!Qi6Zd+0Vkw&%K"
    ),
    "1.5.3, the points with d = 0": (
        "c-n1KU2D`p6y2oFTHB(v*s3T+L}UvR5I-NpsuiIIx8i#lCdp(InoPoELc3x?A9ihV-n{nr_yZJt^RM`(cP81I$_~t&Niz4IIp^Md"
        "aJ~*_I%cQ~1?3?v-5?jtjRegYsIxDqq%Y0>3#@;H1L&z)k_`l?wf6CZOC~r?OE;sO4wxuGEj~~4VE1+XjNxjvi6Cj>m;XXQohKD9"
        "l3+Jw#Md$U@G`HmVpwO#EfYxqYJo%|&-^NiOvc{vn@)TD-l%czTa7=P=ZjBkyw>2225&a_1o8UH=lj2&{rG;{ASlQ1BZhKVX!XjD"
        "9>LM!CwL1zZ$?><q2KSn`h&wPUPprOIi5WRWo?4QV`|Q?l2j%fB|2rA1Uik^!9$kL;@NtQ7vgih<E75@0r9f3lNN8hI)&BJtnn4i"
        "8LwgbZku2XJ6N>Kr>hmReO9_YEwRS)gtI-erQhNG;ycQj>`k>p>;O<Jt#V`)ilRbLv}chB7UaB?q6(xAUs7j~$b8gdN3d!6P+#8i"
        "x+5cK`;?LI|1)v}B^~KITl;7wa#-(hCO9R|5Ey<}vt0LNzZz@Jch%Kt@=n@jev8Wo_gbprhto{APfWk%*`tY}+cgQ(3-&&C1O67;"
        "l*unbGA5~UX$R{}rNrhx0M#W?N(W|piKc13SCX(QunVYUB&9yX&Oa<G-~9`ypF&p"
    ),
    "2.2.3, protocol 5": (
        "c-n1KU2D}a7(P8;PB(N8H#d+mMC1&lAe-QYICUau@eFo9LfWRMWo=rLl%0tKz1VTX-1$2EIsO0z@BAy?>6^5}p0Pmkyh+~gj}N`C"
        "-#RV3^v#0ukV-em1#=@oGY0zVORDHAOMij&k8lJ7-6h#bfL?8~CtNYXX)4`}aynu{f}VSk=E45k>W<=isg@vV;>-Ucpl^_p7fG<6"
        "GU6K<!@R)DtT?Q+BgsS(fSx6h$TPo;BCBz5Hf}Z7pREeJ&nlexUg59$eZGFbRpXr+*J`|5<GmU;YkZ2hw)pwc@8?l;-{Q|74=jT2"
        "Sw9g&by%1z>2~xOPES6;E)2YmcAmg+IDGRLmp#0e0^jR-oe5}X8x*qX8NW<Ym2gZ&Po_y=)Oamqa*P(QZO(W$zCJixZcQ)e!X4rT"
        "-A)?z<E2ZiJH~pvVr<8&Xr|vZG=V)V^73?bLpEm8^{K?3xJEcTAg|3E`WZjey>r@jM~EE*da+Tyti<4`5ERoiM+6IUE|n+)WyI(8"
        "6*Oc&P0+`%?f6hR?|A)V8_>>FLf>CV=oW@_YJ7Iam{PRiyu+Q~R=7i8_^-R%^zg8pn3y;8%4OjR%10)?U4xC7;+-MZMNy&9LEV)q"
        "F901uf+68poy;6K8rTFlH6{n=6GSqms7=ZqmX|7pvvCBvPok8LEP0!zX?`F{SQc1(su)SB&u}nKWa+#A0II!7h5"
    ),
    "3.1.1, protocol 5": (
        "c-nPS%Wl&^6m=3OG)*ZLk5VL5Rj5L#guDTyE>Iy*@rv-GEKxKXJLA}@<5=Ud5+hZ>f>6Zlxa52I0Fc=6E8W4J@r0%bX5n*Zd>=FC"
        "p8K}`W!tv&l8uxmeVT!6?o&Y@b2?=38Ft>m5wxXEh64_Av-ENN5ob=62*wi{XU>o&big>qt~`uK{^5&qkKuCNM36Z0veOWd7f7C@"
        "k$)I7;;9(rd@0F?Y2gr^9&N@WA7qOJd^Gg(AkZn>vx&91PVSdzKPYkOYl%P1`I<SuZ1B3lErT}<ZX3K~a1U|o%BQ<OJ3(+$<M(g3"
        "G=i+_iz4<#kt&*GHQ0rZ#~<JT+TEJ0+ymEjpZ~(8KV3_J*R6MJQ;?NMAka-Nd3h9zC_ygjSseK)P1i!FiptWhs&Ci|SKG4<>+Guh"
        "wTJMctVRp<!}Whuuc+$bHB~#@#4?S=LR08rmp9I~x6dXlb3B?ckjo@tWAaR$;XOl3*5|gCM;|2v^1O+soYMl|wbtQ$G=3>~lngrR"
        ">{L)ql2W4mu)%3Tm7{|i0l7*z%LLxQ{Kk%ldva9~O@a|8G>%ZENcl=k`GAp3r-%3IEe#~l!k4%h(M${SM>MnD|8Q6}STks*!Kxc<"
        "%sE#1!>6<Pep0-SL|>n>9=JkVvO!8gAV010+52;WoHLJvCvQ&56w@-or+&zgliZVbqK3}R)t~S-CRsk9$$%{|9lml=ErN1^T9G#L"
        "lmhAv4TeTVM>3t*CRiDVS#>7R!;G8{nV`B=Jro@k0!Q{p-64qSK$}--9FN8s>E|g*k_tv*>M@+x<1F`_-^V*+IR"
    ),
}
PICKLES = {label: zlib.decompress(base64.b85decode(text)) for label, text in _SAMPLES.items()}
X = [1.5, 2.5, -3.0]
T = [1557539924.5, 1557539924.6, 1557539924.7]
D = [0, 1, 0]
